#!/usr/bin/env bash
# Build wheel and sdist into dist, and try the wheel alone in an empty environment, far from the checkout:
#   scripts/try_wheel.sh [PYTHON]
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}

room=$(mktemp -d)
trap 'rm -rf "$room"' EXIT
"$python" -m venv "$room/build"
"$room/build/bin/pip" install --quiet --disable-pip-version-check build
rm -rf dist
"$room/build/bin/python" -m build --outdir dist . >"$room/build.log" 2>&1 || { cat "$room/build.log"; exit 1; }

"$python" -m venv "$room/env"
"$room/env/bin/pip" install --quiet --disable-pip-version-check dist/*.whl
cd "$room"
unset PYTHONPATH
export PATH="$room/env/bin:$PATH"
tacgen --version
tacgen list >list.txt
grep -q gelsight_mini list.txt && grep -q quickstart list.txt && grep -q hex_bolt list.txt
tacgen init my.yaml
tacgen validate my.yaml
tacgen run quickstart -o out/quickstart --set quality=draft
tacgen check out/quickstart
tacgen view out/quickstart/scene-00000.h5 -o out/quickstart.html
python -c 'import tacgen; print(tacgen.read("out/quickstart/scene-00000.h5").force[-1], tacgen.__file__)'
echo "the wheel works: $(basename "$OLDPWD"/dist/*.whl)"
