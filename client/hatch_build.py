"""Takes the files of tacshade_edge that the client consists of into its wheel and sdist."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FILES = {
    "thin_client.py": "__init__.py",
    **{
        f"{name}.py": f"{name}.py"
        for name in (
            "errors",
            "mqtt/client",
            "mqtt/listener",
            "mqtt/subscription",
            "quoting",
            "reasons",
            "rigid",
            "sensor/geometry/disc",
            "types/geometry",
            "wire/bounds",
            "wire/broker_address",
            "wire/codec",
            "wire/hand_topics",
            "wire/health_topics",
            "wire/received",
            "wire/sensor_topics",
            "wire/topics",
            "wire/wire_format",
        )
    },
}
"""Of tacshade_edge, and what each is in tacshade_client. They import each other relatively; their
folders have no `__init__`, since those of tacshade_edge are about what the client has not.
"""


class FilesOfTacshadeEdge(BuildHookInterface[Any]):
    """An sdist has the files already; an editable installation uses those of the checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files to hatchling."""
        root = Path(self.root)
        if version == "editable" or (root / "PKG-INFO").is_file():
            return
        source = root.parent / "tacshade_edge"
        build_data["force_include"] |= {
            str(source / file): f"tacshade_client/{target}" for file, target in FILES.items()
        }
