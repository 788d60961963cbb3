"""Octo (octo-models/octo): a transformer with a diffusion head, in JAX, told by words or by a picture of the goal.

A checkpoint is what `OctoModel.save_pretrained` writes. Its example batch says which pictures, of which size, and how
many moments the model sees at once; its statistics say how actions are scaled. A session keeps the last moments that
it was asked about. In training they were one step apart, so ask in every step for what the model has learned; after
steps without asking, the last moment is older.
"""

from __future__ import annotations

import importlib
from collections import deque
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput, MissingStack
from vlagents.metadata import ImageSpec, Metadata
from vlagents.observation import Observation
from vlagents.policies import inputs
from vlagents.policies.catalogue import hash_of
from vlagents.policies.sessions import Sessions, told
from vlagents.policies.settings import DELTA_POSE, Settings, check_parts, chosen
from vlagents.policy import Policy

USUAL_RATE = 5.0
"""Of BridgeData V2 [Hz], on whose robot Octo was evaluated most. What a model has learned from is what matters."""
PICTURE, PROPRIO = "image_", "proprio"


@dataclass
class _Memory:
    """What a session remembers: moments as the model takes them, and the key of what it draws."""

    moments: deque[dict[str, NDArray[Any]]]
    key: Any


class OctoPolicy(Policy):
    """Answers with samples of an Octo model, in the units of the dataset whose statistics hold."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load a model.

        Args:
            checkpoint: Folder that `save_pretrained` wrote, or `hf://` and a name.
            settings: `dataset`, `images`, `state` (if the model was trained with proprioception), `action`, `rate`.

        Raises:
            MissingStack: Octo or JAX is not installed.
            InvalidInput: The settings do not fit the model, or the folder is none of a model.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_options(())
        self._jax, model = _stack()
        is_remote = checkpoint.startswith("hf://")
        if not is_remote and not (Path(checkpoint) / "config.json").is_file():
            raise InvalidInput(f"checkpoint is {checkpoint!r}; valid is a folder that OctoModel.save_pretrained wrote.")
        # Orbax wants a path from the root.
        self._model = model.load_pretrained(checkpoint if is_remote else str(Path(checkpoint).resolve()))
        example = self._model.example_batch["observation"]
        self._window: int = example["timestep_pad_mask"].shape[1]
        self._pictures = {name: tuple(example[name].shape[2:4]) for name in example if name.startswith(PICTURE)}
        self._settings = settings
        settings.check_images(list(self._pictures))
        self._dataset, self._statistics = _statistics(self._model.dataset_statistics, settings.dataset)
        self._proprio = example[PROPRIO].shape[-1] if PROPRIO in example else 0
        if self._proprio:
            check_parts("state", settings.state, self._proprio)
        elif settings.state:
            raise InvalidInput("The settings have a state, and this model was trained without proprioception.")
        self._metadata = self._describe(checkpoint, is_remote)
        self._sessions = Sessions(
            lambda seed: _Memory(
                deque(maxlen=self._window),
                self._jax.random.PRNGKey(np.random.default_rng(seed).integers(2**31) if seed is None else seed),
            )
        )
        self._warm_up()

    def _warm_up(self) -> None:
        """Ask once, so that the model is compiled before a robot waits for it."""
        images = {self._settings.camera(name): np.zeros((*size, 3), np.uint8) for name, size in self._pictures.items()}
        state = {part.name: np.zeros(part.size) for part in self._settings.state}
        self.infer(Observation(images=images, state=state, instruction="wait", session="warm-up"))
        self.forget("warm-up")

    def _describe(self, checkpoint: str, is_remote: bool) -> Metadata:
        action = self._settings.action or DELTA_POSE
        check_parts("action", action, len(self._statistics["action"]["mean"]))
        head = self._model.config["model"]["heads"]["action"]["kwargs"]
        return Metadata(
            name="octo",
            action=action,
            images=tuple(ImageSpec(self._settings.camera(name), *size) for name, size in self._pictures.items()),
            state=self._settings.state,
            needs_instruction=False,
            horizon=int(head.get("action_horizon", 1)),
            rate=self._settings.rate or USUAL_RATE,
            checkpoint=checkpoint,
            checkpoint_hash="" if is_remote else hash_of(checkpoint),
            version=_version("octo"),
            extra={"window": self._window, "statistics": self._dataset, "goals": "pictures or words"},
        )

    def metadata(self) -> Metadata:
        """Return what the checkpoint needs and gives."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Forget the session's moments."""
        self._sessions.reset(session, instruction, seed)

    def infer(self, observation: Observation) -> Chunk:
        """Return a sample.

        Raises:
            InvalidInput: A picture or a part of the state is missing, or neither words nor a goal say what to do.
        """
        session = self._sessions.of(observation)
        task = self._task(observation, session)
        memory = session.memory
        memory.moments.append(self._moment(observation))
        moments = list(memory.moments)
        missing = self._window - len(moments)
        padded = [moments[0]] * missing + moments
        shown: dict[str, Any] = {name: np.stack([moment[name] for moment in padded])[None] for name in padded[0]}
        mask = (np.arange(self._window) >= missing)[None]
        shown |= {"timestep_pad_mask": mask, "timestep": np.maximum(np.arange(self._window) - missing, 0)[None]}
        shown["pad_mask_dict"] = dict.fromkeys(padded[0], mask) | {"timestep": mask}
        memory.key, key = self._jax.random.split(memory.key)
        mean_and_scale = {
            name: np.asarray(self._statistics["action"][name])
            for name in ("mean", "std", "mask")
            if name in self._statistics["action"]
        }
        actions = self._model.sample_actions(shown, task, unnormalization_statistics=mean_and_scale, rng=key)
        return Chunk(np.asarray(actions[0], np.float64), 1.0 / self._metadata.rate, observation.time)

    def forget(self, session: str) -> None:
        """Let go of a session."""
        self._sessions.forget(session)

    def _moment(self, observation: Observation) -> dict[str, NDArray[Any]]:
        moment: dict[str, NDArray[Any]] = {
            name: np.array(inputs.picture(observation, self._settings.camera(name), *size))
            for name, size in self._pictures.items()
        }
        if self._proprio:
            values = inputs.numbers(observation, self._settings.state)
            scale = self._statistics[PROPRIO]
            normal = (values - np.asarray(scale["mean"])) / (np.asarray(scale["std"]) + 1e-8)
            moment[PROPRIO] = np.where(scale.get("mask", True), normal, values).astype(np.float32)
        return moment

    def _task(self, observation: Observation, session: Any) -> Any:
        """Return the task as the model takes it: pictures of the goal where there are any, words otherwise, or both."""
        goals = {}
        for name, size in self._pictures.items():
            image = inputs.goal(observation, self._settings.camera(name), *size)
            if image is not None:
                goals[name] = np.array(image)[None]
        words = observation.instruction or session.instruction
        if not goals:
            return self._model.create_tasks(texts=[told(observation, session, "Octo")])
        known = [name for name in self._pictures if name in self._model.example_batch["task"]]
        if missing := sorted(set(known) - set(goals)):
            cameras = [self._settings.camera(name) for name in missing]
            raise InvalidInput(f"The goal has no pictures of {cameras}; this model needs one of each of its cameras.")
        return self._model.create_tasks(goals=goals, texts=[words] if words else None)


def _stack() -> tuple[Any, Any]:
    """Return JAX and Octo's model class."""
    try:
        return importlib.import_module("jax"), importlib.import_module("octo.model.octo_model").OctoModel
    except ImportError as error:  # the index's octo is another project, and has no octo.model
        raise MissingStack("octo", error.name or "octo.model") from error


def _statistics(known: Any, dataset: str) -> tuple[str, dict[str, Any]]:
    """Return whose statistics hold, and them; a model that was fine-tuned on one dataset has no names."""
    if not known:
        raise InvalidInput("The checkpoint has no statistics, so its actions cannot be brought to physical units.")
    if "action" in known:
        return dataset or "the checkpoint's own", known
    name = chosen(dataset, list(known))
    return name, known[name]


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return package
