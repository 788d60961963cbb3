"""V-JEPA 2-AC (facebookresearch/vjepa2): a world model that plans towards an image of the goal.

A video encoder turns images into features; a predictor computes the features that follow a motion of the hand. The
answer is the motion whose features are nearest to the goal's, by the cross-entropy method as in Assran et al. (2025,
section 3.2): draw motions, keep the best, and draw the next ones around them. The task is an image, not words.

A checkpoint is a folder with `encoder/`, a V-JEPA 2 as Transformers saves it, and `predictor.pt`, the published PyTorch
file, whose entry `predictor` is used. The predictor's class comes from a checkout of the original repository, because
no package has it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput, MissingStack
from vlagents.metadata import ImageSpec, Metadata, PartSpec
from vlagents.observation import Observation
from vlagents.policies.catalogue import hash_of
from vlagents.policies.sessions import SessionPolicy
from vlagents.policies.settings import DELTA_POSE, Settings
from vlagents.policies.stack import device, import_stack

USUAL_RATE = 4.0
"""Frames per second of the DROID data in training [Hz]."""
STATE = (PartSpec("xyzrpy", 6, "m, rad"), PartSpec("gripper", 1, "0 closed, 1 open"))
"""Pose of the TCP in the base frame, roll-pitch-yaw about the base's axes, and gripper, as in DROID."""
PICTURE = "image"
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and deviation of ImageNet's colours, with which the encoder was trained."""
LARGEST_GRIP = 0.75
"""Most that the gripper closes or opens in a step, as a share of its range."""
SMALLEST_GRIP = 0.25
"""Smaller shares of its range are noise of the search, and become 0."""
INERTIA = 0.15
"""Share of the mean and deviation that stays from round to round."""
SEARCH = {"horizon": 2, "samples": 400, "best": 10, "rounds": 10, "reach": 0.05}
"""Options of the search: steps that are planned ahead, motions that are drawn in a round and kept of them, rounds, and
most that the hand moves in a step along each axis [m]. More samples find better plans, at proportional time and
memory."""
PREDICTOR = ("predictor_embed_dim", "depth", "num_heads", "num_frames")
"""Options that are sizes of the predictor; by default those of the published model (1024, 24, 16, 64)."""


@dataclass
class _Memory:
    """The memory of a session: its random numbers, and the image and features of its goal."""

    generator: Any
    image: NDArray[np.uint8] | None = None
    goal: Any = None


class Vjepa2AcPolicy(SessionPolicy[_Memory]):
    """Answers with a plan: how far the TCP moves in each step, and where the gripper goes."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load encoder and predictor.

        Args:
            checkpoint: The folder.
            settings: `images` (of the one image, `image`), `rate`, `device`; options are those of `SEARCH`, and
                sizes of the predictor if it is not the published one.

        Raises:
            MissingStack: A package, or the checkout, is not there.
            InvalidInput: A part of the checkpoint is missing, or the parts do not fit.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_images([PICTURE])
        settings.check_options((*SEARCH, *PREDICTOR))
        if settings.state or settings.action or settings.dataset:
            raise InvalidInput("V-JEPA 2-AC's state and actions are those of DROID; the settings cannot change them.")
        self._search = search_of(settings)
        folder = Path(checkpoint)
        if not (folder / "encoder" / "config.json").is_file() or not (folder / "predictor.pt").is_file():
            raise InvalidInput(f"checkpoint is {checkpoint!r}; valid is a folder with encoder/ and predictor.pt.")
        self._torch, transformers, *_ = import_stack("vjepa2_ac", "torch", "transformers", "timm", "PIL")
        self._device = device(self._torch, settings.device)
        self._encoder = transformers.VJEPA2Model.from_pretrained(folder / "encoder").to(self._device).eval()
        sizes = {name: settings.options[name] for name in PREDICTOR if name in settings.options}
        self._predictor = self._load_predictor(folder / "predictor.pt", sizes)
        self._camera = settings.camera(PICTURE)
        super().__init__(
            Metadata(
                name="vjepa2_ac",
                action=DELTA_POSE,
                images=(ImageSpec(self._camera),),
                state=STATE,
                needs_goal=True,
                horizon=self._search["horizon"],
                rate=settings.rate or USUAL_RATE,
                checkpoint=checkpoint,
                checkpoint_hash=hash_of(checkpoint, settings),
                data_hash=settings.data_hash,
            )
        )

    @property
    def _size(self) -> int:
        return int(self._encoder.config.crop_size)

    def _begin(self, seed: int | None) -> _Memory:
        generator = self._torch.Generator()
        if seed is None:
            generator.seed()
        else:
            generator.manual_seed(seed)
        return _Memory(generator)

    def _load_predictor(self, file: Path, sizes: Mapping[str, Any]) -> Any:
        try:
            upstream = importlib.import_module("src.models.ac_predictor")
        except ImportError as error:
            missing = error.name or "src.models.ac_predictor"
            raise MissingStack("vjepa2_ac", f"{missing} (of facebookresearch/vjepa2)") from error
        config = self._encoder.config
        predictor = upstream.vit_ac_predictor(
            img_size=(self._size, self._size),
            patch_size=config.patch_size,
            tubelet_size=config.tubelet_size,
            embed_dim=config.hidden_size,
            **{"num_frames": config.frames_per_clip, **sizes},
        )
        weights = self._torch.load(file, map_location="cpu", weights_only=True)
        weights = weights.get("predictor", weights)
        clean = {key.removeprefix("module.").removeprefix("backbone."): value for key, value in weights.items()}
        try:
            predictor.load_state_dict(clean)
        except RuntimeError as error:
            raise InvalidInput(
                f"{file} does not fit the encoder, or a predictor of these sizes. The options {', '.join(PREDICTOR)} "
                f"say its sizes. {str(error)[:500]}"
            ) from error
        return predictor.to(self._device).eval()

    def infer(self, observation: Observation) -> Chunk:
        """Return the steps of a plan towards the goal's image, or towards the last one of this session.

        Raises:
            InvalidInput: An image or a part of the state is missing, or there is no goal.
        """
        memory = self._session(observation).memory
        pose = observation.numbers(STATE)
        with self._torch.inference_mode():
            here = self._features(observation.image(self._camera))
            motion = self._plan(here, self._goal(observation, memory), pose, memory.generator)
        steps = np.zeros((self._search["horizon"], 7))
        steps[:, :3] = motion[:, :3]
        # The model's last number is how far the gripper closes; ours is where it is, 1 for open.
        steps[:, 6] = np.clip(pose[6] - np.cumsum(motion[:, 3]), 0.0, 1.0)
        return Chunk(steps, 1.0 / self._metadata.rate, observation.time)

    def _goal(self, observation: Observation, memory: _Memory) -> Any:
        """Return the goal's features; an unchanged image is not encoded again."""
        image = observation.goal(self._camera)
        if image is None:
            if memory.goal is None:
                raise InvalidInput(
                    f"V-JEPA 2-AC needs a goal: give its image as goals[{self._camera!r}] of the first observation."
                )
            return memory.goal
        if memory.image is None or not np.array_equal(image, memory.image):
            memory.image, memory.goal = np.array(image), self._features(image)
        return memory.goal

    def _features(self, image: NDArray[np.uint8]) -> Any:
        """Return the encoder's features of an image, (1, patches, width), each of mean 0 and deviation 1."""
        torch = self._torch
        colours = torch.from_numpy(_square(image, self._size)).to(self._device).permute(2, 0, 1).float() / 255.0
        mean, deviation = (torch.tensor(values, device=self._device)[:, None, None] for values in (MEAN, DEVIATION))
        # One image as a still video, as long as the encoder sees at once.
        still = ((colours - mean) / deviation).expand(1, self._encoder.config.tubelet_size, -1, -1, -1)
        return self._normal(self._encoder.get_vision_features(still))

    def _normal(self, features: Any) -> Any:
        return self._torch.nn.functional.layer_norm(features, (features.shape[-1],))

    def _plan(self, here: Any, goal: Any, pose: NDArray[np.float64], generator: Any) -> NDArray[np.float64]:
        """Return a motion (horizon, 4)."""
        torch, patches = self._torch, here.shape[1]
        start = torch.tensor([*pose[:6], 1.0 - pose[6]], dtype=torch.float32, device=self._device)

        def imagine(motions: Any) -> Any:
            count = len(motions)
            seen = here.expand(count, -1, -1)
            poses = start.expand(count, 1, -1)
            actions = torch.cat([motions[..., :3], torch.zeros_like(motions[..., :3]), motions[..., 3:]], dim=-1)
            for step in range(motions.shape[1]):
                follows = self._predictor(seen, actions[:, : step + 1], poses)[:, -patches:]
                seen = torch.cat([seen, self._normal(follows)], dim=1)
                moved = poses[:, -1:] + actions[:, step : step + 1]
                poses = torch.cat([poses, torch.cat([moved[..., :6], moved[..., 6:].clamp(0.0, 1.0)], dim=-1)], dim=1)
            return (seen[:, -patches:] - goal).abs().mean(dim=(1, 2))

        return plan(torch, imagine, self._search, generator, self._device).cpu().numpy().astype(np.float64)


def _square(image: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Return the middle of an image as a square of `size` pixels."""
    from PIL import Image, ImageOps

    return np.array(ImageOps.fit(Image.fromarray(np.array(image)), (size, size), Image.Resampling.BILINEAR))


def search_of(settings: Settings) -> dict[str, Any]:
    """Return the options of the search.

    Raises:
        InvalidInput: One is of another type or out of range.
    """
    search = {name: settings.option(name, default) for name, default in SEARCH.items()}
    if min(search.values()) <= 0 or search["reach"] > 10.0 or not 2 <= search["best"] <= search["samples"]:
        raise InvalidInput(
            f"The options of the search are {search}; valid are numbers above 0, a reach up to 10 m, and best from 2 "
            "to samples."
        )
    return search


def plan(torch: Any, imagine: Callable[[Any], Any], search: Mapping[str, Any], generator: Any, device: Any) -> Any:
    """Return the motion that ends nearest to the goal, (horizon, 4): translation [m], and how far the gripper closes.

    The orientation is kept, as in the experiments of V-JEPA 2.

    Args:
        torch: The module.
        imagine: A function of motions, (samples, horizon, 4), that returns how far from the goal each ends, (samples,).
        search: Values of the options of `SEARCH`.
        generator: Random numbers, on the CPU, so that a seed means the same on all devices.
        device: Where `imagine` works.
    """
    limit = torch.tensor([search["reach"]] * 3 + [LARGEST_GRIP], device=device)
    mean = torch.zeros(search["horizon"], 4, device=device)
    deviation = torch.tensor([search["reach"]] * 3 + [1.0], device=device).repeat(search["horizon"], 1)
    for _ in range(search["rounds"]):
        drawn = torch.randn(search["samples"], search["horizon"], 4, generator=generator).to(device)
        motions = torch.clamp(mean + deviation * drawn, -limit, limit)
        best = motions[torch.topk(imagine(motions), search["best"], largest=False).indices]
        mean = INERTIA * mean + (1.0 - INERTIA) * best.mean(dim=0)
        deviation = INERTIA * deviation + (1.0 - INERTIA) * best.std(dim=0)
    grip = mean[:, 3:]
    return torch.cat([mean[:, :3], torch.where(grip.abs() < SMALLEST_GRIP, 0.0, grip)], dim=1)
