# `make demo`, `make demo-thor` and `make test` each work from a bare clone: they create .venv and install into it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

.PHONY: demo demo-thor test install lint clean
.DELETE_ON_ERROR:

demo: $(VENV)/installed
	@echo "== 2/3 Training on the embedded shapes (minutes; Ctrl-C leaves a checkpoint and says how to go on)"
	$(BIN)/activelsd train experiment=demo
	@echo "== 3/3 Comparing the newest run with its baselines"
	$(BIN)/activelsd compare --baselines no_move,random_walk,all_views

demo-thor: $(VENV)/installed
	@echo "== 2/3 Recording rooms of a stand-in for AI2-THOR, then training in them (Ctrl-C leaves what is done)"
	$(BIN)/activelsd train env=thor env.backend=standin
	@echo "== 3/3 Comparing the newest run with its baselines"
	$(BIN)/activelsd compare --baselines no_move,random_walk,object_search,oracle

test: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -q

install: $(VENV)/installed

$(BIN)/python:
	@echo "== Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or newer is needed; name one: make PYTHON=python3.12")'
	@$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python
	@echo "== 1/3 Installing activelsd into $(VENV) (a minute or more, PyTorch is large)"
	@$(PIP) install -q -c constraints.txt -e .
	@touch $@

$(VENV)/installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	@echo "== Installing activelsd and its tests' tools into $(VENV) (a minute or more, PyTorch is large)"
	@$(PIP) install -q -c constraints.txt -e '.[dev,thor]'
	@$(PIP) install -q --no-deps ai2thor==5.0.0 # without opencv-python, see pyproject.toml
	@touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
