#!/bin/sh
# An environment for OpenVLA: Python 3.11, torch 2.13.0. Run with a folder for it: vlagents recipe openvla | sh -s -- FOLDER
#
# The model's own Python comes with its checkpoint (openvla/openvla-7b and what was fine-tuned from it).
#
#   TORCH        what torch is installed as; upstream trained with torch==2.2.0 (then TORCHVISION=torchvision==0.17.0)
#   TORCHVISION  torchvision==0.28.0
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#   PYTHON       python3.11
set -eu
folder=${1:?name the folder of the environment}
"${PYTHON:-python3.11}" -m venv "$folder"
install() { "$folder/bin/python" -m pip -q --disable-pip-version-check install "$@"; }
install "${TORCH:-torch==2.13.0}"
# By themselves: torchvision names a torch with CUDA, and timm needs nothing else than what is here.
install --no-deps "${TORCHVISION:-torchvision==0.28.0}" timm==0.9.16
install transformers==4.40.1 tokenizers==0.19.1 "numpy<2" pillow safetensors "accelerate<1" sentencepiece "protobuf<6"
install "${VLAGENTS:-rcs-vlagents}"
