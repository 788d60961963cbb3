"""Which images can become a video, and in which pixel format."""

from __future__ import annotations

from typing import Literal

from rcs_data.errors import InvalidSetup

VideoCodec = Literal["h264", "av1"]

# What libx264 and SVT-AV1 take: least length, most lines and most columns [px].
_LIMITS: dict[VideoCodec, tuple[int, int, int]] = {"h264": (1, 16384, 16384), "av1": (64, 8704, 16384)}


def pixel_format(height: int, width: int, codec: VideoCodec) -> str:
    """Return the pixel format of an export: colour at half resolution, or at full resolution if a size is odd.

    Raises:
        InvalidSetup: The codec does not support this image size.
    """
    is_odd = bool(height % 2 or width % 2)
    least, most_lines, most_columns = _LIMITS[codec]
    is_in_range = least <= min(height, width) and height <= most_lines and width <= most_columns
    if not is_in_range or (codec == "av1" and is_odd):
        needs = f"{'even ' if codec == 'av1' else ''}sizes from {least} to {most_columns} x {most_lines}"
        raise InvalidSetup(
            f"Images of {width} x {height} pixels cannot become {codec.upper()} video, which needs {needs}. "
            f"Choose {'the codec h264, or ' if codec == 'av1' else ''}another size."
        )
    return "yuv444p" if is_odd else "yuv420p"


def stored_pixel_format(height: int, width: int, codec: VideoCodec) -> str:
    """Return the pixel format in a dataset: colour at full resolution where the codec has it.

    As H.264 of simulated scenes, that takes no more bytes, and colours are 3 dB nearer. Browsers do not play it, and
    SVT-AV1 does not make it.

    Raises:
        InvalidSetup: The codec does not support this image size.
    """
    usual = pixel_format(height, width, codec)
    return "yuv444p" if codec == "h264" else usual
