# One command each; `make help` lists them. Needs make and Python >= 3.11 with venv, nothing else.

PYTHON ?=
VENV ?= .venv
PIP_ARGS ?=
PYTEST_ARGS ?=
TRAIN_ARGS ?=
NOTEBOOKS ?= $(wildcard notebooks/*.ipynb)

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --constraint constraints.txt $(PIP_ARGS)
# 3.11 first: the versions in constraints.txt were tested with it.
CANDIDATES := $(if $(PYTHON),$(PYTHON),python3.11 python3.12 python3.13 python3.14 python3 python)

.PHONY: help demo train test test-slow notebooks lint format clean
.DEFAULT_GOAL := help

help: ## List the commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo
	@echo "  PYTHON=...      interpreter to build $(VENV) with (default: the first >= 3.11 found)"
	@echo "  PIP_ARGS=...    extra arguments of pip install, such as an index with CPU builds of torch"
	@echo "  PYTEST_ARGS=... extra arguments of pytest     TRAIN_ARGS=... extra arguments of the trainer"
	@echo "  NOTEBOOKS=...   notebooks to run (default: all)"

demo: $(VENV)/.installed-base ## Walk the shipped policy in the simulated robot; plot, video and recording in demo/
	@$(BIN)/asimov demo

train: $(VENV)/.installed-train ## Train a walking policy on this machine (preset `laptop`)
	@$(BIN)/python -m train ppo --preset laptop $(TRAIN_ARGS)

test: lint ## Lint, types, layers and the quick tests
	@$(BIN)/python -m pytest -m "not slow" $(PYTEST_ARGS)

test-slow: lint ## The same with the long tests
	@$(BIN)/python -m pytest $(PYTEST_ARGS)

notebooks: $(VENV)/.installed-all ## Run the notebooks and keep what they print and draw
	@$(BIN)/python notebooks/run.py $(NOTEBOOKS)

lint: $(VENV)/.installed-all ## Formatting, lint, types and the layer contract
	@$(BIN)/ruff format --check --quiet . || { echo "Not formatted: run 'make format'."; exit 1; }
	@$(BIN)/ruff check --quiet .
	@$(BIN)/pyright --pythonpath $(BIN)/python
	@$(BIN)/lint-imports --no-cache

format: $(VENV)/.installed-all ## Format the code and apply the safe fixes of the linter
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

clean: ## Remove the virtual environment, caches, builds and demo/ (training runs stay)
	rm -rf $(VENV) demo build dist .pytest_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp says what is in the environment; it is older than pyproject.toml when that changed, and then pip looks again.
$(VENV)/.installed-base: $(VENV)/.created pyproject.toml constraints.txt
	@echo "Installing asimov-gym into $(VENV)"
	@$(PIP) --editable .
	@touch $@

$(VENV)/.installed-train: $(VENV)/.created pyproject.toml constraints.txt
	@echo "Installing asimov-gym and its trainer into $(VENV)"
	@$(PIP) --editable ".[train]"
	@touch $(VENV)/.installed-base $@

$(VENV)/.installed-all: $(VENV)/.created pyproject.toml constraints.txt
	@echo "Installing asimov-gym, its trainer and the development tools into $(VENV)"
	@$(PIP) --editable ".[train,mjx,brax,notebook,livekit,room,ros2,rosbridge,joint-control,test,dev]"
	@touch $(VENV)/.installed-base $(VENV)/.installed-train $@

$(VENV)/.created:
	@bare=; \
	for python in $(CANDIDATES); do \
	  "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 || continue; \
	  if "$$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then \
	    echo "Creating $(VENV) with $$($$python --version)"; \
	    "$$python" -m venv --clear $(VENV) && touch $@ && exit 0; \
	    exit 1; \
	  fi; \
	  bare=$$python; \
	done; \
	if [ -n "$$bare" ]; then \
	  echo "$$bare has no venv module: install it (Debian and Ubuntu: apt-get install python3-venv)." >&2; \
	else \
	  echo "No Python >= 3.11 among: $(CANDIDATES). Install one, or name it: make PYTHON=/path/to/python" >&2; \
	fi; \
	exit 1
