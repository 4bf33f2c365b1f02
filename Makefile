# make demo   install EnvCraft and validate the examples
# make test   install all extras and run the linters, the type checker and the tests; with -j 2 side by side
# make bench  print the figures in README.md and docs/
# make site   build the documentation as a web site in build/site
# make dist   build the wheel and the source distribution in dist/ and check them
# make interpreters  install that wheel under the other versions of Python here and validate examples
# make new-check NAME=...  write a built-in check with its fixtures and page
# Each target installs what it needs in .venv. It needs Python 3.11 or later with the module venv.

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile --constraint constraints.txt
# uv takes a fraction of pip's time, and where it cannot reach an index that pip is configured for, pip installs.
INSTALL = $(BIN)/uv pip install --quiet --python $(BIN)/python --constraint constraints.txt $(1) || $(PIP) $(1)
# A worker writes no bytecode: without these files it would compile what it imports at each start. Compiling whole
# libraries takes several times as long.
LIBRARIES = PYTHONDONTWRITEBYTECODE= $(BIN)/python -c 'import $(1)'
COMPILE := $(BIN)/python -m compileall -q -j 0 envcraft checks sandbox plugins

.PHONY: demo test lint types pytest bench picture docs site dist interpreters new-check clean

demo: .venv/core.stamp
	$(BIN)/python -m benchmarks.demo

test: lint types pytest

pytest: .venv/dev.stamp
	$(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder $(PYTEST_FLAGS)

lint: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/dev.stamp
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/peers.stamp
	$(BIN)/python -m benchmarks.detection
	$(BIN)/python -m tests.hostile.judge
	$(BIN)/python -m benchmarks.overhead
	$(BIN)/python -m benchmarks.boundary
	$(BIN)/python -m benchmarks.cold
	$(BIN)/python -m benchmarks.launch
	$(BIN)/python -m benchmarks.memory
	$(BIN)/python -m benchmarks.audit
	$(BIN)/python -m benchmarks.audit_scale
	$(BIN)/python -m benchmarks.corpus_store
	$(BIN)/python -m benchmarks.duplicates
	$(BIN)/python -m benchmarks.vector
	$(BIN)/python -m benchmarks.tetris_simulator
	$(BIN)/python -m benchmarks.tetris_speed
	$(BIN)/python -m benchmarks.audit_report
	$(BIN)/python -m benchmarks.explorer
	$(BIN)/python -m benchmarks.composer
	$(BIN)/python -m benchmarks.concepts
	$(BIN)/python -m benchmarks.pipeline
	$(BIN)/python -m benchmarks.conversations
	$(BIN)/python -m benchmarks.tetris_players
	$(BIN)/python -m benchmarks.families
	$(BIN)/python -m benchmarks.demonstrations
	$(BIN)/python -m benchmarks.replay
	$(BIN)/python -m benchmarks.learner
	$(BIN)/python -m benchmarks.learnability

picture: .venv/core.stamp
	$(BIN)/python -m benchmarks.picture

pictures: .venv/dev.stamp
	$(BIN)/python -m benchmarks.explorer_pictures
	$(BIN)/python -m benchmarks.recording

docs: .venv/core.stamp
	$(BIN)/python -m docs.generate

site: .venv/dev.stamp
	$(BIN)/mkdocs build --strict --quiet

dist: .venv/dev.stamp
	rm -rf dist
	$(BIN)/hatchling build
	$(BIN)/twine check --strict dist/*

interpreters: dist
	$(BIN)/python -m tests.e2e.interpreters

new-check: .venv/core.stamp
	$(BIN)/python -m evaluation.new_check $(NAME)
	$(BIN)/python -m docs.generate

clean:
	rm -rf .venv build dist

.venv/pip.stamp:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "EnvCraft needs Python 3.11 or later: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
		{ echo "$(PYTHON) has no venv module; on Debian or Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP) uv
	@touch $@

.venv/core.stamp: .venv/pip.stamp pyproject.toml constraints.txt
	$(call INSTALL,--editable .)
	$(call LIBRARIES,gymnasium)
	$(COMPILE)
	@touch $@

.venv/dev.stamp: .venv/pip.stamp pyproject.toml constraints.txt
	# Only pip finds a build without CUDA on every index that has one.
	$(PIP) torch
	$(call INSTALL,--editable '.[dev]')
	$(call LIBRARIES,gymnasium) & $(call LIBRARIES,torch); wait
	$(COMPILE)
	@touch $@ .venv/core.stamp

.venv/peers.stamp: .venv/dev.stamp
	$(call INSTALL,--editable '.[peers]')
	@grep -v '^#' benchmarks/trainer_requirements.txt | while read -r peer; do \
		{ $(call INSTALL,"$$peer"); } || echo "left out: $$peer"; done
	@touch $@
