#!/bin/sh
# An environment for OpenVLA-OFT: Python 3.11, torch 2.13.0. Run with a folder for it:
# vlagents recipe openvla_oft | sh -s -- FOLDER
#
#   OFT_REPO     a checkout of moojink/openvla-oft, commit 213c5ff: its package prismatic is imported.
#   OFT_TRANSFORMERS_REPO  a checkout of moojink/transformers-openvla-oft, commit bc339d9: Transformers 4.40.1 whose Llama
#                looks both ways, without which a chunk's actions would not see each other.
#   DLIMP_REPO   a checkout of moojink/dlimp_openvla or kvablack/dlimp, commit ad72ce3: prismatic imports it
#   TORCH        what torch is installed as; upstream trained with torch==2.2.0 (then TORCHVISION=torchvision==0.17.0)
#   TORCHVISION  torchvision==0.28.0
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#   PYTHON       python3.11
set -eu
folder=${1:?name the folder of the environment}
: "${OFT_REPO:?name the folder of a checkout of moojink/openvla-oft at commit 213c5ff}"
: "${OFT_TRANSFORMERS_REPO:?name the folder of a checkout of moojink/transformers-openvla-oft at commit bc339d9}"
: "${DLIMP_REPO:?name the folder of a checkout of kvablack/dlimp at commit ad72ce3}"
"${PYTHON:-python3.11}" -m venv "$folder"
install() { "$folder/bin/python" -m pip -q --disable-pip-version-check install "$@"; }
install "${TORCH:-torch==2.13.0}"
install --no-deps "${TORCHVISION:-torchvision==0.28.0}" timm==0.9.16
install tokenizers==0.19.1 "numpy<2" pillow safetensors "accelerate<1" sentencepiece "protobuf<4.24" "huggingface-hub<1" \
  tqdm regex requests filelock packaging pyyaml diffusers==0.30.3 einops peft==0.11.1 draccus==0.8.0 rich \
  tensorflow-cpu==2.15.0 tensorflow_datasets==4.9.3 json-numpy jsonlines "setuptools<81" wheel
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
cp -R "$OFT_TRANSFORMERS_REPO" "$copy/transformers" && cp -R "$DLIMP_REPO" "$copy/dlimp" && cp -R "$OFT_REPO" "$copy/oft"
install --no-deps --no-build-isolation "$copy/transformers" "$copy/dlimp" "$copy/oft"
install "${VLAGENTS:-rcs-vlagents}"
