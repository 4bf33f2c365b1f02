"""The tables of a corpus as numbered migrations. The database's ``user_version`` is the number of the last one."""

from __future__ import annotations

import sqlite3

from envcraft.errors import UsageError

#: A released migration never changes. A change of the schema is a new migration at the end.
MIGRATIONS = (
    """
    CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL);
    CREATE TABLE audits (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        settings INTEGER NOT NULL REFERENCES settings (id),
        started TEXT NOT NULL,
        ended TEXT,
        selected INTEGER NOT NULL,
        known INTEGER NOT NULL
    );
    CREATE TABLE settings (
        id INTEGER PRIMARY KEY,
        digest TEXT NOT NULL UNIQUE,
        contract TEXT NOT NULL,
        contract_sha256 TEXT NOT NULL,
        rules TEXT NOT NULL,
        seed INTEGER NOT NULL,
        budget TEXT NOT NULL,
        driver TEXT NOT NULL,
        image TEXT NOT NULL
    );
    CREATE TABLE verdicts (
        id INTEGER PRIMARY KEY,
        source TEXT NOT NULL,
        class TEXT NOT NULL,
        settings INTEGER NOT NULL REFERENCES settings (id),
        verdict TEXT NOT NULL,
        steps INTEGER NOT NULL,
        seconds REAL NOT NULL,
        report TEXT NOT NULL,
        UNIQUE (source, class, settings)
    );
    CREATE INDEX verdicts_by_settings ON verdicts (settings, verdict);
    CREATE TABLE findings (
        verdict INTEGER NOT NULL REFERENCES verdicts (id) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        rule_check TEXT NOT NULL,
        code TEXT NOT NULL,
        severity TEXT NOT NULL,
        line INTEGER,
        message TEXT NOT NULL,
        PRIMARY KEY (verdict, number)
    ) WITHOUT ROWID;
    CREATE INDEX findings_by_code ON findings (code, verdict);
    CREATE TABLE environments (
        name TEXT PRIMARY KEY,
        source TEXT NOT NULL CHECK (length(source) = 64),
        class TEXT NOT NULL,
        origin TEXT NOT NULL,
        added TEXT NOT NULL,
        changed INTEGER NOT NULL,
        verdict INTEGER REFERENCES verdicts (id) ON DELETE SET NULL
    );
    CREATE INDEX environments_by_source ON environments (source, class);
    CREATE INDEX environments_by_verdict ON environments (verdict);
    """,
    # Keys can be computed again from the sources at any time. NULL means that the source has no key.
    """
    CREATE TABLE keys (
        source TEXT NOT NULL,
        layer TEXT NOT NULL,
        version INTEGER NOT NULL,
        key BLOB,
        PRIMARY KEY (source, layer)
    );
    """,
    """
    CREATE TABLE previews (
        source TEXT NOT NULL,
        class TEXT NOT NULL,
        recipe TEXT NOT NULL,
        media TEXT,
        PRIMARY KEY (source, class)
    ) WITHOUT ROWID;
    CREATE INDEX previews_by_media ON previews (media);
    """,
    # For earlier audits, the checks are unknown ('?') until the next audit with the same rules.
    "ALTER TABLE settings ADD COLUMN checks TEXT NOT NULL DEFAULT '?';",
    # Whether an audit covered all that had changed. This is unknown for earlier audits.
    "ALTER TABLE audits ADD COLUMN complete INTEGER NOT NULL DEFAULT 0;",
    # The generation of environments: the results of each stage for each concept.
    """
    CREATE TABLE concepts (
        id TEXT PRIMARY KEY,
        title TEXT NOT NULL,
        text TEXT NOT NULL,
        data TEXT NOT NULL
    ) WITHOUT ROWID;
    CREATE TABLE briefs (
        concept TEXT PRIMARY KEY REFERENCES concepts (id) ON DELETE CASCADE,
        text TEXT NOT NULL,
        provenance TEXT NOT NULL
    ) WITHOUT ROWID;
    CREATE TABLE attempts (
        concept TEXT NOT NULL REFERENCES concepts (id) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        source TEXT NOT NULL CHECK (length(source) = 64),
        class TEXT NOT NULL,
        diff TEXT NOT NULL,
        result TEXT NOT NULL,
        gutted TEXT NOT NULL,
        codes TEXT NOT NULL,
        profile TEXT NOT NULL,
        verdict INTEGER REFERENCES verdicts (id) ON DELETE SET NULL,
        provenance TEXT NOT NULL,
        PRIMARY KEY (concept, number)
    ) WITHOUT ROWID;
    CREATE INDEX attempts_by_source ON attempts (source);
    CREATE INDEX attempts_by_verdict ON attempts (verdict);
    CREATE TABLE policies (
        concept TEXT NOT NULL REFERENCES concepts (id) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        source TEXT NOT NULL,
        wins INTEGER NOT NULL,
        episodes INTEGER NOT NULL,
        fault TEXT NOT NULL,
        provenance TEXT NOT NULL,
        PRIMARY KEY (concept, number)
    ) WITHOUT ROWID;
    CREATE TABLE outcomes (
        concept TEXT NOT NULL REFERENCES concepts (id) ON DELETE CASCADE,
        stage TEXT NOT NULL,
        result TEXT NOT NULL,
        reason TEXT NOT NULL,
        facts TEXT NOT NULL,
        PRIMARY KEY (concept, stage)
    ) WITHOUT ROWID;
    """,
    """
    CREATE TABLE demonstrations (
        id INTEGER PRIMARY KEY,
        source TEXT NOT NULL,
        class TEXT NOT NULL,
        contract_sha256 TEXT NOT NULL,
        player TEXT NOT NULL,
        player_digest TEXT NOT NULL,
        seed INTEGER NOT NULL,
        contract TEXT NOT NULL,
        steps INTEGER NOT NULL,
        file TEXT NOT NULL CHECK (length(file) = 64),
        recorded TEXT NOT NULL,
        UNIQUE (source, class, contract_sha256, player, player_digest, seed)
    );
    CREATE INDEX demonstrations_by_file ON demonstrations (file);
    CREATE TABLE episodes (
        demonstration INTEGER NOT NULL REFERENCES demonstrations (id) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        seed INTEGER NOT NULL,
        steps INTEGER NOT NULL,
        total REAL,
        success INTEGER,
        ending TEXT NOT NULL,
        PRIMARY KEY (demonstration, number)
    ) WITHOUT ROWID;
    """,
    # The rules of all default checks, if only some checks ran. This is unknown for earlier audits.
    "ALTER TABLE settings ADD COLUMN offered TEXT NOT NULL DEFAULT '';",
)


def version(connection: sqlite3.Connection, where: str) -> int:
    """Return the number of a database's last migration.

    Args:
        connection: to the database.
        where: names the corpus in messages.

    Raises:
        UsageError: the number is higher than this version of EnvCraft knows.
    """
    number: int = connection.execute("PRAGMA user_version").fetchone()[0]
    if number > len(MIGRATIONS):
        raise UsageError(
            f"the corpus {where} has schema {number}, and this version of EnvCraft knows schemas up to "
            f"{len(MIGRATIONS)}: use the version that wrote it, or a later one"
        )
    return number


def migrate(connection: sqlite3.Connection, where: str) -> None:
    """Apply the missing migrations, each in a transaction.

    Args:
        connection: to the database.
        where: names the corpus in messages.

    Raises:
        UsageError: the database is of a later version of EnvCraft.
        sqlite3.Error: a migration failed.
    """
    for number in range(version(connection, where) + 1, len(MIGRATIONS) + 1):
        try:
            connection.executescript(
                f"BEGIN IMMEDIATE; {MIGRATIONS[number - 1]}; PRAGMA user_version = {number}; COMMIT;"
            )
        except sqlite3.Error:
            if connection.in_transaction:
                connection.rollback()
            raise
