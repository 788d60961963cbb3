"""Octo (octo-models/octo): a transformer with a diffusion head, in JAX; its task is words or an image of the goal.

A checkpoint is what `OctoModel.save_pretrained` writes. Its example batch has the images, their sizes, and the
number of moments that the model sees at once; its statistics scale the actions. A session keeps the last moments that
were observed. In training they were one step apart, so call the policy in every step.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import ImageSpec, Metadata
from vlagents.observation import Observation
from vlagents.policies.catalogue import hash_of
from vlagents.policies.sessions import SessionPolicy
from vlagents.policies.settings import DELTA_POSE, Settings, check_parts, chosen
from vlagents.policies.stack import import_stack

USUAL_RATE = 5.0
"""Rate of BridgeData V2 [Hz], on whose robot Octo was evaluated most; settings give that of other data."""
PICTURE, PROPRIO = "image_", "proprio"


@dataclass
class _Memory:
    """The memory of a session: moments as the model takes them, and the key of its random numbers."""

    moments: deque[dict[str, NDArray[Any]]]
    key: Any


class OctoPolicy(SessionPolicy[_Memory]):
    """Answers with samples of an Octo model, in the units of the dataset whose statistics hold."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load a model.

        Args:
            checkpoint: Folder that `save_pretrained` wrote, or `hf://` and a name.
            settings: `dataset`, `images`, `state` (if the model was trained with proprioception), `action`, `rate`.

        Raises:
            MissingStack: Octo or JAX is not installed.
            InvalidInput: The settings do not fit the model, or the folder has no model.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_options(())
        self._jax, upstream = import_stack("octo", "jax", "octo.model.octo_model")
        is_remote = checkpoint.startswith("hf://")
        if not is_remote and not (Path(checkpoint) / "config.json").is_file():
            raise InvalidInput(f"checkpoint is {checkpoint!r}; valid is a folder that OctoModel.save_pretrained wrote.")
        # Orbax needs an absolute path.
        self._model = upstream.OctoModel.load_pretrained(checkpoint if is_remote else str(Path(checkpoint).resolve()))
        example = self._model.example_batch["observation"]
        self._window: int = example["timestep_pad_mask"].shape[1]
        self._pictures = {name: tuple(example[name].shape[2:4]) for name in example if name.startswith(PICTURE)}
        self._settings = settings
        settings.check_images(list(self._pictures))
        self._statistics = _statistics(self._model.dataset_statistics, settings.dataset)
        self._proprio = example[PROPRIO].shape[-1] if PROPRIO in example else 0
        if self._proprio:
            check_parts("state", settings.state, self._proprio)
        elif settings.state:
            raise InvalidInput("The settings have a state, and this model was trained without proprioception.")
        super().__init__(self._describe(checkpoint, is_remote))
        self._warm_up()

    def _begin(self, seed: int | None) -> _Memory:
        drawn = np.random.default_rng(seed).integers(2**31) if seed is None else seed
        return _Memory(deque(maxlen=self._window), self._jax.random.PRNGKey(drawn))

    def _describe(self, checkpoint: str, is_remote: bool) -> Metadata:
        action = self._settings.action or DELTA_POSE
        check_parts("action", action, len(self._statistics["action"]["mean"]))
        head = self._model.config["model"]["heads"]["action"]["kwargs"]
        return Metadata(
            name="octo",
            action=action,
            images=tuple(ImageSpec(self._settings.camera(name), *size) for name, size in self._pictures.items()),
            state=self._settings.state,
            needs_goal=self._model.text_processor is None,
            horizon=int(head.get("action_horizon", 1)),
            rate=self._settings.rate or USUAL_RATE,
            checkpoint=checkpoint,
            checkpoint_hash="" if is_remote else hash_of(checkpoint, self._settings),
            data_hash=self._settings.data_hash,
        )

    def infer(self, observation: Observation) -> Chunk:
        """Return a sample.

        Raises:
            InvalidInput: An image or a part of the state is missing, or there is neither an instruction nor a goal.
        """
        task = self._task(observation)
        memory = self._session(observation).memory
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

    def _moment(self, observation: Observation) -> dict[str, NDArray[Any]]:
        moment: dict[str, NDArray[Any]] = {
            name: np.array(observation.image(self._settings.camera(name), *size))
            for name, size in self._pictures.items()
        }
        if self._proprio:
            values = observation.numbers(self._settings.state)
            scale = self._statistics[PROPRIO]
            normal = (values - np.asarray(scale["mean"])) / (np.asarray(scale["std"]) + 1e-8)
            moment[PROPRIO] = np.where(scale.get("mask", True), normal, values).astype(np.float32)
        return moment

    def _task(self, observation: Observation) -> Any:
        """Return the task as the model takes it: images of the goal where there are any, words otherwise, or both."""
        goals = {}
        for name, size in self._pictures.items():
            image = observation.goal(self._settings.camera(name), *size)
            if image is not None:
                goals[name] = np.array(image)[None]
        if not goals and self._metadata.needs_goal:
            cameras = [self._settings.camera(name) for name in self._pictures]
            raise InvalidInput(f"This model takes no words; give images of the goal of {cameras}, as `goals`.")
        if not goals:
            return self._model.create_tasks(texts=[self._instruction(observation)])
        words = observation.instruction or self._session(observation).instruction
        if self._metadata.needs_goal:
            words = ""
        known = [name for name in self._pictures if name in self._model.example_batch["task"]]
        if missing := sorted(set(known) - set(goals)):
            cameras = [self._settings.camera(name) for name in missing]
            raise InvalidInput(f"The goal has no images of {cameras}; this model needs one of each of its cameras.")
        return self._model.create_tasks(goals=goals, texts=[words] if words else None)


def _statistics(known: Any, dataset: str) -> dict[str, Any]:
    """Return a dataset's statistics; those of a model that was fine-tuned on one dataset have no name."""
    if not known:
        raise InvalidInput("The checkpoint has no statistics, so its actions cannot be brought to physical units.")
    return known if "action" in known else known[chosen(dataset, list(known))]
