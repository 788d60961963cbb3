#!/bin/sh
# An environment for openpi's pi0, pi0-FAST and pi0.5: Python 3.11, JAX 0.5.3 with CUDA 12, and uv. Run with a folder for it:
# vlagents recipe openpi | sh -s -- FOLDER
#
#   OPENPI_REPO  a checkout of Physical-Intelligence/openpi, commit 15a9616 (June 2026), with its submodules. What the
#                package index calls openpi is a placeholder.
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#
# openpi's own lock file says all versions; it names a commit of LeRobot, so git must reach it. A checkpoint of JAX needs a
# GPU with 8 GB or more to answer. Where openpi's server runs already, nothing of this is needed:
# vlagents serve openpi --checkpoint ws://HOST:8000 --settings FILE
set -eu
folder=${1:?name the folder of the environment}
: "${OPENPI_REPO:?name the folder of a checkout of Physical-Intelligence/openpi at commit 15a9616}"
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
export UV_PROJECT_ENVIRONMENT="$folder" GIT_LFS_SKIP_SMUDGE=1
(cd "$OPENPI_REPO" && uv sync --python 3.11 --frozen)
uv pip install --python "$folder/bin/python" "${VLAGENTS:-rcs-vlagents}"
