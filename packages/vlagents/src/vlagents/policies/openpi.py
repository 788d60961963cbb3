"""openpi's pi0, pi0-FAST and pi0.5 (Physical-Intelligence/openpi): in this process, or behind openpi's own server.

The checkpoint is a folder that openpi's training wrote, with the option `config`, or the address `ws://host:port` of a
stock openpi server, which needs no other packages here. Observations and actions have openpi's keys and conventions on
that side, and names and units of the robot on ours. A layout converts between the two.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import ImageSpec, Metadata, PartSpec
from vlagents.observation import Observation
from vlagents.policies.catalogue import hash_of
from vlagents.policies.sessions import SessionPolicy
from vlagents.policies.settings import Settings, check_parts
from vlagents.policies.stack import import_stack
from vlagents.remote import RemotePolicy, connect

SIZE = 224
"""Height and width of the models' images [pixels]. openpi pads other shapes with black, as `Resized` does."""
DROID_STEP = 0.2
"""Motion of a joint in 1/15 s at a velocity of 1 in DROID's units [rad]: its solver's `max_joint_delta`."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A conversion between openpi's keys and a robot's parts."""

    images: tuple[str, ...]
    """openpi's keys of images, which are also the keys of `Settings.images`."""
    state: tuple[PartSpec, ...]
    """Parts of the robot's state that are needed."""
    action: tuple[PartSpec, ...]
    """Parts of an action."""
    rate: float
    """Rate of the data [Hz]."""
    to_state: Callable[[NDArray[np.float64]], dict[str, NDArray[Any]]]
    """Returns openpi's state for the parts side by side."""
    to_actions: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Returns actions in the robot's units for openpi's."""


def _droid_state(values: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    # DROID's gripper is 0 when it is open.
    return {
        "observation/joint_position": values[:7].astype(np.float32),
        "observation/gripper_position": (1.0 - values[7:]).astype(np.float32),
    }


def _droid_actions(actions: NDArray[np.float64]) -> NDArray[np.float64]:
    steps = DROID_STEP * np.clip(actions[:, :7], -1.0, 1.0)
    # DROID's own program makes it open or closed at a half, too.
    return np.concatenate([steps, np.where(actions[:, 7:8] > 0.5, 0.0, 1.0)], axis=1)


DROID = Layout(
    images=("observation/exterior_image_1_left", "observation/wrist_image_left"),
    state=(PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "0 closed, 1 open")),
    action=(PartSpec("joints", 7, "rad", "delta"), PartSpec("gripper", 1, "0 closed, 1 open")),
    rate=15.0,
    to_state=_droid_state,
    to_actions=_droid_actions,
)
"""Layout of the checkpoints pi0_droid, pi0_fast_droid and pi05_droid, which give joint velocities."""


def own_layout(settings: Settings) -> Layout:
    """Return the layout of a model that was fine-tuned on a dataset of one's own.

    Images are `observation/<camera>`, the state is `observation/state`, actions are as they were recorded.

    Raises:
        InvalidInput: The settings lack images, state, action or rate.
    """
    if not (settings.images and settings.state and settings.action and settings.rate):
        raise InvalidInput(
            "For a model that was fine-tuned on other data, the settings must have images, state, action and rate; for "
            "a published one of DROID, `layout` in their options is 'droid'."
        )
    return Layout(
        images=tuple(settings.images),
        state=settings.state,
        action=settings.action,
        rate=settings.rate,
        to_state=lambda values: {"observation/state": values.astype(np.float32)},
        to_actions=lambda actions: actions,
    )


class OpenpiPolicy(SessionPolicy[None]):
    """Answers with chunks of an openpi model."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load a model, or connect to a server.

        Args:
            checkpoint: A folder of openpi's training, or `ws://host:port`.
            settings: `images`, and for a layout of one's own `state`, `action` and `rate`; options `layout` ("droid" or
                "own"), `config` (of a folder: openpi's name of it, or a file of Python with a TrainConfig called
                CONFIG, which is run; it is looked for beside the checkpoint, then in the working folder) and `timeout`
                (how long a server may take to answer [s], 30).

        Raises:
            MissingStack: openpi is not installed.
            InvalidInput: The settings do not fit.
            ConnectionLost: No server is at the address.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_options(("layout", "config", "timeout"))
        name = settings.option("layout", "own")
        if name not in ("droid", "own"):
            raise InvalidInput(f"The option 'layout' is {name!r}; valid: droid, own.")
        self._layout = DROID if name == "droid" else own_layout(settings)
        self._settings = settings
        if name == "droid":
            settings.check_images(list(self._layout.images))
            if settings.state or settings.action:
                raise InvalidInput("The layout 'droid' has its own state and actions; the settings must not.")
        self._client: RemotePolicy | None = None
        if is_address := checkpoint.startswith(("ws://", "wss://")):
            # The layout has the actions' real period.
            self._client = connect(checkpoint, timeout=settings.option("timeout", 30.0), period=1.0)
        else:
            self._model = _trained(checkpoint, settings)
        metadata = Metadata(
            name="openpi",
            action=self._layout.action,
            images=tuple(ImageSpec(settings.camera(key), SIZE, SIZE) for key in self._layout.images),
            state=self._layout.state,
            needs_instruction=True,
            rate=self._layout.rate,
            checkpoint=checkpoint,
            checkpoint_hash="" if is_address else hash_of(checkpoint, settings, _code_of(checkpoint, settings)),
            data_hash=settings.data_hash,
        )
        super().__init__(metadata)
        self._metadata = replace(metadata, horizon=len(self._warm_up().actions))

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode. openpi draws from one stream for all sessions, so a seed has no effect."""
        super().reset(session, instruction)
        if self._client is not None:
            self._client.reset()

    def infer(self, observation: Observation) -> Chunk:
        """Return a chunk.

        Raises:
            InvalidInput: An image or a part of the state is missing, or there is no instruction.
            ConnectionLost: The server has gone; `reset` connects again.
            DeadlineExceeded: It did not answer in time.
        """
        instruction = self._instruction(observation)
        images = {
            key: np.array(observation.image(self._settings.camera(key), SIZE, SIZE)) for key in self._layout.images
        }
        state = self._layout.to_state(observation.numbers(self._layout.state))
        if self._client is not None:
            actions = self._client.infer(Observation(images, state, instruction)).actions
        else:
            answer = self._model.infer({**images, **state, "prompt": instruction})
            actions = np.asarray(answer["actions"], np.float64)
        check_parts("action", self._layout.action, actions.shape[-1])
        return Chunk(self._layout.to_actions(actions), 1.0 / self._layout.rate, observation.time)

    def close(self) -> None:
        """End the connection to a server."""
        if self._client is not None:
            self._client.close()


def _trained(checkpoint: str, settings: Settings) -> Any:
    """Return openpi's policy of a checkpoint."""
    config = settings.option("config", "")
    if not config:
        raise InvalidInput("The option 'config' is missing; give the name of the openpi config that trained the model.")
    policies, configs = import_stack("openpi", "openpi.policies.policy_config", "openpi.training.config")
    file = _code_of(checkpoint, settings)
    made = configs.get_config(config) if file is None else _config_of(file)
    # openpi joins paths to it, so it must be absolute.
    return policies.create_trained_policy(made, Path(checkpoint).resolve())


def _code_of(checkpoint: str, settings: Settings) -> Path | None:
    """Return the file of Python with the config, in the checkpoint's folder or in this one; None for openpi's own.

    Raises:
        InvalidInput: There is no such file.
    """
    config = settings.option("config", "")
    if not config.endswith(".py"):
        return None
    for place in (Path(checkpoint) / config, Path(config)):
        if place.is_file():
            return place
    raise InvalidInput(f"The option 'config' is {config!r}; there is no such file here or in {checkpoint}.")


def _config_of(file: Path) -> Any:
    """Return the TrainConfig that a file of Python defines.

    Raises:
        InvalidInput: There is no CONFIG in it.
    """
    spec = importlib.util.spec_from_file_location("openpi_config", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    if not hasattr(module, "CONFIG"):
        raise InvalidInput(f"{file} defines no CONFIG.")
    return module.CONFIG
