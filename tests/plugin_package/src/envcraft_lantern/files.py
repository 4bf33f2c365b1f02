"""The export `files`: the sources as they are, with a list of digests that ``sha256sum --check`` reads."""

from __future__ import annotations

from envcraft.corpus.export.exporter import Exporter, Order, fresh_folder


class FilesExporter(Exporter):
    name = "files"
    summary = "the sources, and SHA256SUMS"

    def export(self, order: Order) -> list[str]:
        with fresh_folder(order.output) as folder:
            sums = []
            for environment in order.environments():
                place = folder / environment.name
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(order.store.source(environment.source))
                sums.append(f"{environment.source}  {environment.name}\n")
            (folder / "SHA256SUMS").write_text("".join(sums))
        return [f"wrote {len(sums)} environments", f"  cd {order.output} && sha256sum --check SHA256SUMS"]
