#!/usr/bin/env bash
# Makes sure that offscreen OpenGL (EGL) is there: on Debian-like systems installs it, elsewhere says what to install.
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
probe='import moderngl; moderngl.create_context(standalone=True, backend="egl").release()'
if "$here/.venv/bin/python" -c "$probe" 2>/dev/null; then
    exit 0
fi
packages="libegl1 libgl1-mesa-dri"
run=""
if [ "$(id -u)" -ne 0 ]; then
    run="sudo -n"
fi
if command -v apt-get >/dev/null && { [ -z "$run" ] || $run true 2>/dev/null; }; then
    echo "Installing $packages for offscreen OpenGL"
    $run apt-get update -qq
    DEBIAN_FRONTEND=noninteractive $run apt-get install -y -qq $packages >/dev/null
    exit 0
fi
echo "No offscreen OpenGL (EGL) here; install Mesa's (Debian: $packages, Fedora: mesa-libEGL mesa-dri-drivers). Pictures are drawn on the CPU until then."
