# One command runs the main job (make demo), one proves that it works (make test); both set up all they need.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
SHELL := /bin/bash

# Every test that starts a command would compile torch's sources again, four seconds each time.
unexport PYTHONDONTWRITEBYTECODE

# The Visible Human's thigh, where its data lie beside the project.
THIGH := $(if $(wildcard ../shared/data/volumes/vhm_thigh_rgba.npz),$(shell echo ,thigh))

# Scenes whose pictures show other individuals than the capture, as people have them.
OTHERS := watermelon_others,orange_others,apple_others,pomegranate_others

# All methods but those that draw label by label, which take minutes a scene: the three samples have these too.
METHODS := ours,physgaussian,inpainting,no_clipping,no_opacity,no_smoothing,no_refinement,uniform,oracle

.PHONY: demo test bench screenshots words clean

demo: $(READY)
	@tools/ensure_gl.sh
	$(BIN)/fruitninja-train sample_scenes/watermelon/watermelon.ply -o out/watermelon \
	    --exemplar horizontal=sample_scenes/watermelon/horizontal_1.png \
	    --exemplar radial=sample_scenes/watermelon/radial_1.png --up z --detail draft
	$(BIN)/fruitninja-render out/watermelon/watermelon.ply -o out/watermelon/opened.png --plane 0.35,-0.2,1,0
	@echo
	@echo "Pictures: out/watermelon/opened.png (cut open), out/watermelon/cuts.png (six cuts nobody trained)"
	@echo "The solid: out/watermelon/watermelon.ply; figures: out/watermelon/report.json"

# Writing a cache that is not there yet takes a fifth of mypy's time.
MYPY_CACHE := $(if $(wildcard .mypy_cache),,--cache-dir=/dev/null)

test:
	@tools/ensure_gl.sh browser & $(MAKE) --no-print-directory $(READY); made=$$?; wait && exit $$made
	@tools/ensure_gl.sh window
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(BIN)/mypy $(MYPY_CACHE) & $(BIN)/python -m pytest -n 2 --dist worksteal; tests=$$?; wait $$! && exit $$tests

# The template that translations begin with; docs: CONTRIBUTING.md.
words: $(READY)
	$(BIN)/pybabel extract --no-wrap --sort-by-file --add-location=file --project FruitNinja \
	    --copyright-holder "the FruitNinja authors" -o app/locale/fruitninja.pot app training/events.py

bench: $(READY)
	@tools/ensure_gl.sh
	$(BIN)/fruitninja-evaluate --cuts 24 -o out/evaluation \
		--scenes $(OTHERS),watermelon,orange,bread,apple,pomegranate,cake$(THIGH) --methods $(METHODS)
	cp out/evaluation/report.json docs/charts/evaluation_scenes.json
	$(BIN)/fruitninja-evaluate --cuts 120 --seeds 3 --detail standard -o out/evaluation_seeds \
		--scenes $(OTHERS) --methods ours
	cp out/evaluation_seeds/report.json docs/charts/evaluation_seeds.json
	$(BIN)/fruitninja-evaluate --cuts 24 -o out/evaluation
	cp out/evaluation/report.json docs/charts/evaluation.json
	$(BIN)/python -m benchmarks.oblique_cuts --scenes $(OTHERS),watermelon,orange,bread$(THIGH)
	$(BIN)/python -m benchmarks.label_makers
	$(BIN)/python -m benchmarks.face_detail
	$(BIN)/python -m benchmarks.interior
	$(BIN)/python -m benchmarks.fidelity
	$(BIN)/python -m benchmarks.presets
	$(BIN)/python -m benchmarks.stability
	$(BIN)/python -m benchmarks.worn_captures
	$(BIN)/python -m benchmarks.large
	$(BIN)/python -m benchmarks.batch_scaling
	$(BIN)/python -m benchmarks.frozen_geometry
	$(BIN)/python -m benchmarks.cpu_renderer
	$(BIN)/python -m benchmarks.gl_frames
	$(BIN)/python -m benchmarks.by_hand

screenshots: $(READY)
	@tools/ensure_gl.sh window
	@tools/ensure_gl.sh browser
	$(BIN)/python -m tools.screenshots
	$(BIN)/python -m tools.sheet
	$(BIN)/python -m tools.film
	$(BIN)/python -m tools.page

# Constraints are the versions the tests were run with; an editable install, so that a change needs no new one.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[dev,bench,diffusion,docs,export,usd]'
	@touch $(READY)

clean:
	rm -rf $(VENV) out build *.egg-info
