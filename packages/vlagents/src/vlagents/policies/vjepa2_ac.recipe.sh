#!/bin/sh
# An environment for V-JEPA 2-AC: Python 3.11, torch 2.13.0. Run with a folder for it:
# vlagents recipe vjepa2_ac | sh -s -- FOLDER
#
#   VJEPA2_REPO  a checkout of facebookresearch/vjepa2, commit c2963a4; the predictor's class is there and in no package.
#   TORCH        what torch is installed as; torch==2.13.0
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#   PYTHON       python3.11
#
# A checkpoint is made of two: encoder/ is facebook/vjepa2-vitg-fpc64-256 as Transformers saves it, predictor.pt is
# upstream's vjepa2-ac-vitg.pt.
set -eu
folder=${1:?name the folder of the environment}
: "${VJEPA2_REPO:?name the folder of a checkout of facebookresearch/vjepa2 at commit c2963a4}"
"${PYTHON:-python3.11}" -m venv "$folder"
install() { "$folder/bin/python" -m pip -q --disable-pip-version-check install "$@"; }
install "${TORCH:-torch==2.13.0}"
# Torchvision beside timm would be another gigabyte, with CUDA, for transforms that are not used.
install --no-deps torchvision==0.28.0 timm==1.0.22
install transformers==4.57.6 numpy==2.2.6 pillow safetensors
install "${VLAGENTS:-rcs-vlagents}"
# Upstream's modules are called src.*, and are no package: they are copied, and their folder is on the path.
mkdir -p "$folder/vjepa2"
cp -R "$VJEPA2_REPO/src" "$folder/vjepa2/"
site=$("$folder/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
(cd "$folder/vjepa2" && pwd) >"$site/vjepa2.pth"
