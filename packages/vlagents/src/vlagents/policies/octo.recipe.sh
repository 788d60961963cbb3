#!/bin/sh
# An environment for Octo: Python 3.11, JAX 0.4.20, no GPU. Run with a folder for it: vlagents recipe octo | sh -s -- FOLDER
#
#   OCTO_REPO    a checkout of octo-models/octo, commit 241fb35 (July 2024). The package "octo" of the index is another project.
#   DLIMP_REPO   a checkout of kvablack/dlimp, commit ad72ce3, which Octo imports.
#   VLAGENTS     where vlagents comes from; rcs-vlagents
#   PYTHON       python3.11; TensorFlow 2.15 has no wheels for a newer one
#   JAX          what JAX is installed as; for a GPU with CUDA 12: "jax[cuda12_pip]==0.4.20"
set -eu
folder=${1:?name the folder of the environment}
: "${OCTO_REPO:?name the folder of a checkout of octo-models/octo at commit 241fb35}"
: "${DLIMP_REPO:?name the folder of a checkout of kvablack/dlimp at commit ad72ce3}"
"${PYTHON:-python3.11}" -m venv "$folder"
install() { "$folder/bin/python" -m pip -q --disable-pip-version-check install "$@"; }
install "${JAX:-jax==0.4.20}" jaxlib==0.4.20 flax==0.7.5 distrax==0.1.5 chex==0.1.85 optax==0.1.5 ml_dtypes==0.2.0 \
  "scipy<1.13" numpy==1.24.3 tensorflow-cpu==2.15.0 tensorflow_probability==0.23.0 orbax-checkpoint==0.4.4 \
  transformers==4.38.2 tensorflow_datasets==4.9.2 "protobuf<4.24" einops==0.8.1 ml_collections \
  tqdm pillow "setuptools<81" wheel
# What they ask for themselves is fixed above: the TensorFlow that they name has CUDA. The build is in a copy, so that
# the checkouts stay as they are.
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
cp -R "$DLIMP_REPO" "$copy/dlimp" && cp -R "$OCTO_REPO" "$copy/octo"
install --no-deps --no-build-isolation "$copy/dlimp" "$copy/octo"
install "${VLAGENTS:-rcs-vlagents}"
