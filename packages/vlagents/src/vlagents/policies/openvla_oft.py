"""OpenVLA-OFT (moojink/openvla-oft): OpenVLA that answers with a chunk, from several pictures and the robot's state.

A checkpoint is a folder with the model, `dataset_statistics.json`, and the parts that OFT adds beside it:
`action_head--*checkpoint.pt` and, with proprioception, `proprio_projector--*checkpoint.pt`. Its Python runs when it is
loaded, and it imports upstream's package `prismatic`, which fixes sizes by a platform's name when it is imported.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput, MissingStack
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policies import inputs
from vlagents.policies.openvla import PROMPT, describe, load, picture_for, prompt
from vlagents.policies.sessions import Sessions, told
from vlagents.policies.settings import Settings, check_parts, chosen
from vlagents.policies.torch_stack import device, import_stack, precision
from vlagents.policy import Policy

PLATFORMS = ("libero", "bridge", "aloha")
"""Names that `prismatic` knows: chunks of 8, 5 and 25 actions, of 7, 7 and 14 numbers."""
PICTURES = ("full_image", "left_wrist_image", "right_wrist_image")
"""Upstream's names, in the order in which the model sees them."""


class OpenvlaOftPolicy(Policy):
    """Answers with chunks from continuous heads; what was discrete in OpenVLA is regressed here."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load a model and its heads.

        Args:
            checkpoint: A folder as upstream's fine-tuning writes one.
            settings: `dataset`, `images` (upstream's names, as many as the model sees), `state` (if there is a
                projector of proprioception), `action`, `rate`, `device`; options `platform` ("libero") and
                `center_crop` (true).

        Raises:
            MissingStack: A package is not installed.
            InvalidInput: The settings do not fit the model, or a part of the checkpoint is missing.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_images(list(PICTURES))
        settings.check_options(("platform", "center_crop"))
        self._settings = settings
        self._pictures = tuple(name for name in PICTURES if name in settings.images) or PICTURES[:1]
        self._is_cropped = settings.option("center_crop", True)
        platform = settings.option("platform", "libero")
        if platform not in PLATFORMS:
            raise InvalidInput(f"The option 'platform' is {platform!r}; valid: {', '.join(PLATFORMS)}.")
        self._torch, transformers, *_ = import_stack("openvla_oft", "transformers", "timm", "PIL")
        self._constants = _constants(platform)
        self._device = device(self._torch, settings.device)
        self._precision = precision(self._torch, self._device)
        self._model, self._processor = load(transformers, checkpoint, self._precision, "eager")
        self._model.vision_backbone.set_num_images_in_input(len(self._pictures))
        self._model.to(self._device).eval()
        self._dataset = chosen(settings.dataset, list(self._model.norm_stats), "dataset (OpenVLA calls it unnorm_key)")
        self._head, self._projector = self._parts(Path(checkpoint))
        self._metadata = describe(
            "openvla_oft",
            checkpoint,
            settings,
            self._model,
            self._dataset,
            pictures=self._pictures,
            horizon=int(self._constants.NUM_ACTIONS_CHUNK),
        )
        self._sessions = Sessions(lambda _: None)

    def _parts(self, folder: Path) -> tuple[Any, Any]:
        """Return the head, and what projects the state, with their weights."""
        width = self._model.llm_dim
        heads = importlib.import_module("prismatic.models.action_heads")
        size = int(self._constants.ACTION_DIM)
        head = self._filled(heads.L1RegressionActionHead(width, width, size), folder, "action_head")
        if head is None:
            raise InvalidInput(f"{folder} has no action_head--*checkpoint.pt; OpenVLA's own checkpoints are `openvla`.")
        projectors = importlib.import_module("prismatic.models.projectors")
        state = int(self._constants.PROPRIO_DIM)
        projector = self._filled(projectors.ProprioProjector(width, state), folder, "proprio_projector")
        if projector is not None:
            check_parts("state", self._settings.state, state)
        elif self._settings.state:
            raise InvalidInput(f"The settings have a state, and {folder} has no proprio_projector--*checkpoint.pt.")
        return head, projector

    def _filled(self, module: Any, folder: Path, name: str) -> Any:
        """Return a module with the weights of the one file of its name; None where there is no file."""
        files = sorted(folder.glob(f"{name}--*checkpoint.pt"))
        if not files:
            return None
        if len(files) > 1:
            raise InvalidInput(f"{folder} has {', '.join(file.name for file in files)}; valid is one of them.")
        weights = self._torch.load(files[0], map_location="cpu", weights_only=True)
        module.load_state_dict({key.removeprefix("module."): value for key, value in weights.items()})
        return module.to(self._device, dtype=self._precision).eval()

    def metadata(self) -> Metadata:
        """Return what the checkpoint needs and gives."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Remember what is to be done. Nothing is drawn by chance, and no picture remembered."""
        self._sessions.reset(session, instruction)

    def infer(self, observation: Observation) -> Chunk:
        """Return a chunk.

        Raises:
            InvalidInput: A picture or a part of the state is missing, or there is no instruction.
        """
        text = prompt(PROMPT, told(observation, self._sessions.of(observation), "OpenVLA-OFT"))
        seen = []
        for name in self._pictures:
            image = picture_for(inputs.picture(observation, self._settings.camera(name)), self._is_cropped)
            seen.append(self._processor(text, image).to(self._device, dtype=self._precision))
        given = dict(seen[0])
        given["pixel_values"] = self._torch.cat([each["pixel_values"] for each in seen], dim=1)
        state = None
        if self._projector is not None:
            values = inputs.numbers(observation, self._settings.state)
            state = _normal(values, self._model.norm_stats[self._dataset]["proprio"], self._limits())
        with self._torch.inference_mode():
            actions, _ = self._model.predict_action(
                **given,
                unnorm_key=self._dataset,
                do_sample=False,
                proprio=state,
                proprio_projector=self._projector,
                action_head=self._head,
            )
        return Chunk(np.asarray(actions, np.float64), 1.0 / self._metadata.rate, observation.time)

    def forget(self, session: str) -> None:
        """Let go of a session."""
        self._sessions.forget(session)

    def _limits(self) -> tuple[str, str]:
        """Return the names of the statistics that become -1 and 1."""
        kind = getattr(self._constants.ACTION_PROPRIO_NORMALIZATION_TYPE, "value", "")
        return ("min", "max") if kind == "bounds" else ("q01", "q99")


def _constants(platform: str) -> Any:
    """Import upstream's package for a platform. It looks for the platform's name in the words of the command.

    Raises:
        MissingStack: The package is not installed.
        InvalidInput: It was imported for another platform in this process.
    """
    name = "prismatic.vla.constants"
    words = list(sys.argv)
    sys.argv[:] = [words[0], platform]
    try:
        constants = importlib.import_module(name)
    except ImportError as error:
        raise MissingStack("openvla_oft", error.name or "prismatic") from error
    finally:
        sys.argv[:] = words
    if not hasattr(constants, "ROBOT_PLATFORM"):
        raise MissingStack("openvla_oft", "prismatic (of openvla-oft, not of openvla)")
    if str(constants.ROBOT_PLATFORM).lower() != platform:
        raise InvalidInput(f"prismatic was imported for {constants.ROBOT_PLATFORM}; a process serves one platform.")
    return constants


def _normal(values: NDArray[np.float64], statistics: dict[str, Any], limits: tuple[str, str]) -> NDArray[np.float64]:
    """Return numbers scaled from their limits to -1 … 1 and clipped, but for those that the mask leaves as they are."""
    low, high = (np.asarray(statistics[name], np.float64) for name in limits)
    mask = np.asarray(statistics.get("mask", np.ones(len(low), bool)))
    scaled = 2.0 * (values - low) / (high - low + 1e-8) - 1.0
    return np.clip(np.where(mask, scaled, values), -1.0, 1.0)
