"""Checkpoints of LeRobot (huggingface/lerobot): ACT, Diffusion Policy, SmolVLA, VQ-BeT and others alike.

A checkpoint is the folder `pretrained_model` that LeRobot's trainer writes, or a run's folder, whose last checkpoint is
used. It has the shapes of the model's inputs, but not their meaning, which is in `vlagents.json` in the folder that is
given, or else beside the weights.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import ImageSpec, Metadata, PartSpec
from vlagents.observation import Observation
from vlagents.policies.catalogue import hash_of
from vlagents.policies.sessions import SessionPolicy
from vlagents.policies.settings import FILE, Settings, check_parts
from vlagents.policies.stack import device, import_stack

STATE, ACTION, IMAGES = "observation.state", "action", "observation.images."
"""LeRobot's names of inputs and outputs."""
INSTRUCTED = ("smolvla", "pi0", "pi05", "pi0_fast", "xvla", "groot", "wall_x")
"""Types that need an instruction in words."""


@dataclass
class Memory:
    """The memory of a session."""

    seed: int
    """Seed of the model's random numbers."""
    answers: int = 0
    """Number of answers since the reset."""
    queues: Any = None
    """The model's own queues of observations; None for empty ones."""
    time: float = 0.0
    """Time of the last observation [s]."""


class LerobotPolicy(SessionPolicy[Memory]):
    """Answers an observation with a chunk, in the units of the data that the model has learned from.

    ACT and SmolVLA answer with all rows that they predict. Diffusion Policy and VQ-BeT read their last observations and
    answer with `n_action_steps` rows. They have learned from observations one step apart: after a longer time, as when
    chunks are executed to their end, they start again from the new observation.
    """

    def __init__(self, checkpoint: str, settings: Settings | None = None, *, family: str = "") -> None:
        """Load a model.

        Args:
            checkpoint: Folder of a checkpoint, or of a run.
            settings: `images` (camera by image, without `observation.images.`), `state`, `action`, `rate`, `device`.
            family: The type that it must have, such as `act`; empty for any.

        Raises:
            MissingStack: LeRobot is not installed.
            InvalidInput: It is no checkpoint of that type, or the settings do not fit it.
        """
        folder = find(checkpoint)
        has_own = (Path(checkpoint) / FILE).is_file()  # a run has settings beside its checkpoints
        settings = settings or Settings.read(checkpoint if has_own else folder)
        settings.check_options(())
        packages = ("lerobot.policies.factory", "lerobot.configs.policies")
        self._torch, factory, configs = import_stack("lerobot", "torch", *packages)
        config = configs.PreTrainedConfig.from_pretrained(folder)
        if family and config.type != family:
            raise InvalidInput(f"{folder} is a checkpoint of {config.type!r}; serve it as that, or as 'lerobot'.")
        self._device = device(self._torch, settings.device)
        config.device = str(self._device)
        # The checkpoint has all weights, so none are downloaded.
        for name, value in (("pretrained_backbone_weights", None), ("load_vlm_weights", False)):
            if hasattr(config, name):
                setattr(config, name, value)
        self._model = factory.get_policy_class(config.type).from_pretrained(folder, config=config)
        self._model.to(self._device).eval()
        self._before, self._after = factory.make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides={"device_processor": {"device": str(self._device)}},
        )
        self._model.reset()
        queues = getattr(self._model, "_queues", None) or {}
        self._is_remembering = any(key != ACTION for key in queues)
        self._cameras = {
            key: settings.camera(key.removeprefix(IMAGES)) for key in config.input_features if key.startswith(IMAGES)
        }
        settings.check_images([key.removeprefix(IMAGES) for key in self._cameras])
        super().__init__(self._describe(config, folder, settings))

    def infer(self, observation: Observation) -> Chunk:
        """Return the next actions.

        Raises:
            InvalidInput: An image, a part of the state or the instruction is missing, or has another size.
        """
        shown = self._shown(observation)
        shown["task"] = self._instruction(observation) if self._metadata.needs_instruction else ""
        period = 1.0 / self._metadata.rate if self._metadata.rate else 1.0
        memory = self._session(observation).memory
        with self._torch.random.fork_rng(), self._torch.inference_mode():
            self._torch.manual_seed((memory.seed + memory.answers) % 2**63)
            rows = self._rows(self._before(shown), memory, observation.time, period)
            actions = self._after(rows).cpu().numpy().astype(np.float64)
        memory.answers += 1
        memory.time = observation.time
        return Chunk(actions, period, observation.time)

    def _begin(self, seed: int | None) -> Memory:
        return Memory(secrets.randbits(31) if seed is None else seed)

    def _rows(self, batch: Any, memory: Memory, time: float, period: float) -> Any:
        """Return the rows of a chunk as the model scales them, (rows, size)."""
        self._model.reset()
        if not self._is_remembering:
            return self._model.predict_action_chunk(batch)[0]
        is_next = not self._metadata.rate or 0 < time - memory.time < 1.5 * period
        if memory.queues is not None and is_next:
            self._model._queues = memory.queues
        first = self._model.select_action(batch)
        queues = self._model._queues
        rows = [first, *queues[ACTION]]
        queues[ACTION].clear()
        memory.queues = queues
        return self._torch.cat(rows)

    def _shown(self, observation: Observation) -> dict[str, Any]:
        """Return an observation as LeRobot's datasets have it, with an axis of one before the others."""
        found: dict[str, Any] = {}
        for key, image in zip(self._cameras, self._metadata.images, strict=True):
            array = np.array(observation.image(image.name, image.height, image.width))
            found[key] = self._torch.from_numpy(array).permute(2, 0, 1)[None].float() / 255
        if self._metadata.state:
            values = observation.numbers(self._metadata.state)
            found[STATE] = self._torch.from_numpy(values).float()[None]
        return found

    def _describe(self, config: Any, folder: Path, settings: Settings) -> Metadata:
        action = config.output_features[ACTION].shape[0]
        state = config.input_features[STATE].shape[0] if STATE in config.input_features else 0
        other = sorted(set(config.input_features) - set(self._cameras) - {STATE})
        if other:
            raise InvalidInput(f"{folder} needs {', '.join(other)}, which robots here do not observe.")
        parts = {
            "state": settings.state or ((PartSpec("state", state),) if state else ()),
            "action": settings.action or (PartSpec("action", action),),
        }
        check_parts("state", parts["state"], state)
        check_parts("action", parts["action"], action)
        images = (
            ImageSpec(camera, *map(int, config.input_features[key].shape[1:])) for key, camera in self._cameras.items()
        )
        return Metadata(
            name=config.type,
            action=parts["action"],
            state=parts["state"],
            images=tuple(images),
            needs_instruction=config.type in INSTRUCTED,
            horizon=int(self._model._queues[ACTION].maxlen if self._is_remembering else config.chunk_size),
            rate=settings.rate,
            checkpoint=str(folder),
            checkpoint_hash=hash_of(folder, settings),
            data_hash=settings.data_hash,
        )


def find(checkpoint: str) -> Path:
    """Return the folder with `config.json`: a checkpoint, or the last one of a run.

    Raises:
        InvalidInput: There is none.
    """
    given = Path(checkpoint)
    for folder in (given, given / "pretrained_model", given / "checkpoints" / "last" / "pretrained_model"):
        if checkpoint and (folder / "config.json").is_file():
            return folder
    raise InvalidInput(
        f"checkpoint is {checkpoint!r}; valid is a folder of LeRobot with config.json, or the folder of a run with "
        "checkpoints/last."
    )
