#!/usr/bin/env bash
# Makes sure that offscreen OpenGL (EGL) is there; with the argument "window" a virtual screen for window tests as well.
# With "browser" it is a browser for tests of pages instead, where the system has one as a package (100 MB, half a
# minute). On Debian-like systems what is missing is installed; elsewhere one line says what to install.
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
missing=()
browser=""
if [ "${1:-}" = browser ]; then
    if ! command -v chromium-headless-shell chromium google-chrome >/dev/null; then
        browser=chromium-headless-shell
    fi
else
    if ! "$here/.venv/bin/python" -c 'import moderngl; moderngl.create_context(standalone=True, backend="egl").release()' 2>/dev/null; then
        missing+=(libegl1 libgl1-mesa-dri)
    fi
    if [ "${1:-}" = window ] && ! command -v xvfb-run >/dev/null; then
        missing+=(xvfb xauth libgl1 libglx-mesa0 libgl1-mesa-dri)
    fi
fi
if [ ${#missing[@]} -eq 0 ] && [ -z "$browser" ]; then
    exit 0
fi
run=""
if [ "$(id -u)" -ne 0 ]; then
    run="sudo -n"
fi
if command -v apt-get >/dev/null && { [ -z "$run" ] || $run true 2>/dev/null; }; then
    install() {
        echo "Installing $*"
        $run env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "$@" >/dev/null
    }
    $run apt-get update -qq
    if [ ${#missing[@]} -gt 0 ]; then
        install "${missing[@]}"
    fi
    if [ -n "$browser" ]; then
        install "$browser" || echo "No Chromium: tests of pages are skipped."
    fi
    exit 0
fi
if [ ${#missing[@]} -eq 0 ]; then
    echo "No Chromium: tests of pages are skipped."
    exit 0
fi
echo "Please install ${missing[*]} (Fedora: mesa-libEGL mesa-dri-drivers xorg-x11-server-Xvfb); until then pictures are drawn on the CPU and such tests are skipped."
