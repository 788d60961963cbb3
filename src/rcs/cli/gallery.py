"""`rcs gallery`: a page of pictures of every environment."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rcs_data.cli.console import plain_console
from rcs_data.output import require_writable

from rcs.rollout.gallery import gallery


@dataclass(kw_only=True)
class GalleryCommand:
    """Draw every environment in both qualities, and what its cameras see, on one page."""

    out: Path = field(default_factory=lambda: Path("datasets/gallery"))
    """Folder for the page and its pictures."""
    seed: int = 0
    """Of the episodes shown."""

    def run(self) -> int:
        """Draw and tell where the page is."""
        require_writable(self.out)
        console = plain_console()
        with console.status("Drawing"):
            for shot in gallery(self.out, seed=self.seed):
                console.print(f"{shot.group}, {shot.title}: {shot.file}")
        console.print(f"Page: {self.out / 'index.html'}")
        return 0
