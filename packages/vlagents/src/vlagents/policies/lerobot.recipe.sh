#!/bin/sh
# An environment for LeRobot's policies (ACT, Diffusion Policy, SmolVLA and others): Python 3.11, LeRobot 0.4.4, torch 2.13.0.
# It serves and trains them. Run with a folder for it: vlagents recipe lerobot | sh -s -- FOLDER
#
#   TORCH        what torch is installed as; torch==2.13.0
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#   PYTHON       python3.11; LeRobot 0.5 and later want 3.12
#
# torchcodec reads a dataset's videos with FFmpeg's libraries, the package ffmpeg of Debian and others.
set -eu
folder=${1:?name the folder of the environment}
"${PYTHON:-python3.11}" -m venv "$folder"
install() { "$folder/bin/python" -m pip -q --disable-pip-version-check install "$@"; }
install "${TORCH:-torch==2.13.0}"
# LeRobot 0.4.4 allows torch up to 2.10, and works with 2.13; so what it asks for is named here.
install --no-deps torchvision==0.28.0 lerobot==0.4.4 torchcodec==0.13.0
install "datasets>=4,<5" "diffusers>=0.27.2,<0.36" "huggingface-hub>=0.34.2,<0.36" "accelerate>=1.10" einops \
  "opencv-python-headless<4.13" "av>=15,<16" jsonlines "packaging<26" draccus==0.10.0 "gymnasium>=1.1.1,<2" "deepdiff<9" \
  imageio termcolor "transformers>=4.57.1,<5" num2words safetensors wandb==0.24.2 "setuptools<81" pynput pyserial matplotlib
install "${VLAGENTS:-rcs-vlagents}"
