"""Files of checkpoints: values come back as they were, and nothing in the bytes is run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import CorruptCheckpoint
from rcs.rl.checkpoint import packed, unpacked

pytestmark = pytest.mark.extras


def test_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    import torch  # pyright: ignore[reportMissingImports]

    class Canary:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "it ran"),)

    torch.save({"weights": Canary()}, tmp_path / "policy.pt")
    with pytest.raises(CorruptCheckpoint, match=r"policy.pt is damaged"):
        unpacked((tmp_path / "policy.pt").read_bytes(), tmp_path / "policy.pt")
    assert not (tmp_path / "it ran").exists()


def test_values_survive_a_file() -> None:
    values: dict[str, Any] = {
        "array": np.arange(6, dtype=np.uint32).reshape(2, 3), "flags": np.array([True, False]), "none": None,
        "nested": {"tuple": (1, 2.5, "text"), "empty": np.zeros((0, 3))}, "list": [np.float32(0.1)], "number": 2**70,
    }  # fmt: skip
    read = unpacked(packed(values), Path("a file"))
    assert np.array_equal(read["array"], values["array"]) and read["array"].dtype == np.uint32
    assert read["nested"]["tuple"] == (1, 2.5, "text")
    assert read["nested"]["empty"].shape == (0, 3)
    assert (read["none"], read["number"], read["flags"].tolist()) == (None, 2**70, [True, False])
    assert read["list"] == [float(np.float32(0.1))]
