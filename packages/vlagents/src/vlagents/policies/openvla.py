"""OpenVLA (openvla/openvla): a language model that reads an image and an instruction and writes one action in tokens.

A checkpoint is a folder as Transformers saves it, with `dataset_statistics.json` if it was fine-tuned. It has Python
files of its own, which run when it is loaded: serve only checkpoints that you trust.
"""

from __future__ import annotations

import json
import math
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
from vlagents.policies.stack import device, import_stack

USUAL_RATE = 5.0
"""Rate of BridgeData V2 [Hz]; settings give that of other data."""
EMPTY = 29871
"""Number of the empty token of Llama 2, between the text and the action."""
CROP = 0.9
"""Share of an image's area that is kept, in the middle, for models that were trained with random crops."""
PROMPT = "In: What action should the robot take to {}?\nOut:"
PROMPT_V01 = (
    "A chat between a curious user and an artificial intelligence assistant. "
    "The assistant gives helpful, detailed, and polite answers to the user's questions. "
    "USER: What action should the robot take to {}? ASSISTANT:"
)
"""Prompt of the models called v01, which are based on Vicuna."""


class OpenvlaPolicy(SessionPolicy[None]):
    """Answers each observation with one action, in the units of the dataset whose statistics hold."""

    def __init__(self, checkpoint: str, settings: Settings | None = None) -> None:
        """Load a model.

        Args:
            checkpoint: A folder that Transformers saved, or a name of its hub.
            settings: `dataset` (upstream: unnorm_key), `images` (of the one image, `image`), `action`, `rate`,
                `device`; options `center_crop` (false; true for models trained with random crops), `v01` (false; true
                for the prompt of those models) and `attention` ("sdpa", "eager" or "flash_attention_2").

        Raises:
            MissingStack: A package is not installed.
            InvalidInput: The settings do not fit the model.
        """
        settings = settings or Settings.read(checkpoint)
        settings.check_images(["image"])
        settings.check_options(("center_crop", "v01", "attention"))
        if settings.state:
            raise InvalidInput("The settings have a state, and OpenVLA takes none.")
        self._is_cropped = settings.option("center_crop", False)
        self._prompt = PROMPT_V01 if settings.option("v01", "v01" in checkpoint) else PROMPT
        self._torch, transformers, *_ = import_stack("openvla", "torch", "transformers", "timm", "PIL")
        self._device = device(self._torch, settings.device)
        # A CPU is slow with less than float32.
        self._precision = self._torch.bfloat16 if self._device.type == "cuda" else self._torch.float32
        self._model, self._processor = load(
            transformers, checkpoint, self._precision, settings.option("attention", "eager")
        )
        self._model.to(self._device).eval()
        self._dataset = chosen(settings.dataset, list(self._model.norm_stats), "dataset (OpenVLA calls it unnorm_key)")
        self._camera = settings.camera("image")
        action = settings.action or DELTA_POSE
        check_parts("action", action, len(self._model.norm_stats[self._dataset]["action"]["q01"]))
        super().__init__(
            Metadata(
                name="openvla",
                action=action,
                images=(ImageSpec(self._camera),),  # any size is stretched to the model's, as in training
                needs_instruction=True,
                rate=settings.rate or USUAL_RATE,
                checkpoint=checkpoint,
                checkpoint_hash=hash_of(checkpoint, settings) if Path(checkpoint).is_dir() else "",
                data_hash=settings.data_hash,
            )
        )

    def infer(self, observation: Observation) -> Chunk:
        """Return the next action.

        Raises:
            InvalidInput: There is no image, or no instruction.
        """
        instruction = self._instruction(observation)
        image = picture_for(observation.image(self._camera), self._is_cropped)
        given = self._processor(prompt(self._prompt, instruction), image).to(self._device, dtype=self._precision)
        end_with_empty(self._torch, given)
        with self._torch.inference_mode():
            action = self._model.predict_action(**given, unnorm_key=self._dataset, do_sample=False)
        return Chunk(np.atleast_2d(np.asarray(action, np.float64)), 1.0 / self._metadata.rate, observation.time)


def end_with_empty(torch: Any, given: Any) -> None:
    """End a text with the empty token, which it ended with in training.

    The model's code adds the token where it is missing, but not to the mask, which only some attention takes.

    Args:
        torch: The package.
        given: Has `input_ids` and `attention_mask`, (1, tokens) each; both are replaced.
    """
    tokens = given["input_ids"]
    if tokens[0, -1] != EMPTY:
        given["input_ids"] = torch.cat([tokens, torch.full_like(tokens[:, :1], EMPTY)], dim=1)
        mask = given["attention_mask"]
        given["attention_mask"] = torch.cat([mask, torch.ones_like(mask[:, :1])], dim=1)


def load(transformers: Any, checkpoint: str, precision: Any, attention: str) -> tuple[Any, Any]:
    """Return a checkpoint's model, with the statistics of what it was fine-tuned on, and its processor."""
    processor = transformers.AutoProcessor.from_pretrained(checkpoint, trust_remote_code=True)
    model = transformers.AutoModelForVision2Seq.from_pretrained(
        checkpoint,
        torch_dtype=precision,
        low_cpu_mem_usage=True,
        trust_remote_code=True,
        attn_implementation=attention,
    )
    statistics = Path(checkpoint) / "dataset_statistics.json"
    if statistics.is_file():
        model.norm_stats = json.loads(statistics.read_text(encoding="utf-8"))
    if not model.norm_stats:
        raise InvalidInput("The checkpoint has no statistics, so its actions cannot be brought to physical units.")
    return model, processor


def prompt(form: str, instruction: str) -> str:
    """Return the text that the model goes on from: the instruction in lower case, without a full stop at its end."""
    return form.format(instruction.strip().rstrip(".").lower())


def picture_for(image: NDArray[np.uint8], is_cropped: bool) -> Any:
    """Return an image as the processor takes it; a cropped one is the middle at the same size."""
    from PIL import Image, ImageOps

    found = Image.fromarray(np.array(image)).convert("RGB")
    if not is_cropped:
        return found
    return ImageOps.fit(found, found.size, Image.Resampling.BILINEAR, bleed=(1.0 - math.sqrt(CROP)) / 2.0)
