"""The tables of a corpus, as numbered migrations: the database's ``user_version`` says how many it has had."""

from __future__ import annotations

import sqlite3

from envcraft.errors import UsageError

#: Never changed once released; what is to be different goes into a new one at the end.
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
    # What may be made again from the sources at any time. A key that is NULL says that the source has none.
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
    # What ran before is not known; the next audit with the same rules says it.
    "ALTER TABLE settings ADD COLUMN checks TEXT NOT NULL DEFAULT '?';",
    # Whether an audit was about all that had changed; of those before, nobody knows.
    "ALTER TABLE audits ADD COLUMN complete INTEGER NOT NULL DEFAULT 0;",
    # How environments came about: of each concept what was made of it, and how far it came.
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
    # The rules that some checks were chosen from; of those before, nobody knows.
    "ALTER TABLE settings ADD COLUMN offered TEXT NOT NULL DEFAULT '';",
)


def version(connection: sqlite3.Connection, where: str) -> int:
    """How many migrations a database has had. Raises UsageError where it has had more than are known."""
    found: int = connection.execute("PRAGMA user_version").fetchone()[0]
    if found > len(MIGRATIONS):
        raise UsageError(
            f"the corpus {where} has schema {found}, and this version of EnvCraft knows up to {len(MIGRATIONS)}: "
            "use the version that wrote it, or a later one"
        )
    return found


def migrate(connection: sqlite3.Connection, where: str) -> None:
    """Bring a database up to date, one transaction a migration. Raises UsageError, sqlite3.Error."""
    for number in range(version(connection, where) + 1, len(MIGRATIONS) + 1):
        try:
            connection.executescript(
                f"BEGIN IMMEDIATE; {MIGRATIONS[number - 1]}; PRAGMA user_version = {number}; COMMIT;"
            )
        except sqlite3.Error:
            if connection.in_transaction:
                connection.rollback()
            raise
