# Everything below needs Python 3.11 or later and make; the first target that needs it builds .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-compose check format schemas scenes models benchmark clean

$(VENV)/ready: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"expected Python 3.11 or later, got {sys.version.split()[0]}")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check torch==2.13.0
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

demo: $(VENV)/ready  ## one bundled scene, optimised by the whole system; writes out/demo/
	$(BIN)/frugal demo

test: $(VENV)/ready  ## all tests that need no container engine
	$(BIN)/python -m pytest -q -m 'not system'

test-compose: $(VENV)/ready  ## the same system in containers; needs a Docker engine with Compose
	$(BIN)/python -m pytest -q -m system tests/system --timeout 1500

check: $(VENV)/ready  ## style, types, architecture
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports --no-cache

format: $(VENV)/ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

schemas: $(VENV)/ready  ## rewrite proto_schemas/ from the messages
	$(BIN)/python -m common.wire.schemas

scenes: $(VENV)/ready  ## rewrite the bundled scenes from their seeds
	$(BIN)/python -m pipelines.cases

models: $(VENV)/ready  ## the released weights from their seeds, and the data sets they are trained on: ours, and the paper's narrow setting
	$(BIN)/frugal data generate --name sim-v1 --train 4000 --test 300 --seed 0
	$(BIN)/frugal train learned
	$(BIN)/frugal train mde --model heuristic
	$(BIN)/frugal train mde --model learned
	$(BIN)/frugal data generate --name narrow-v1 --preset narrow --train 1000 --test 300 --seed 0
	$(BIN)/frugal train learned --data data/narrow-v1 --variant paper --threads 1 --out models/narrow/learned
	$(BIN)/frugal train learned --data data/narrow-v1 --epochs 60 --threads 1 --out models/narrow/learned_window
	$(BIN)/frugal train mde --data data/narrow-v1 --model heuristic --out models/narrow/mde_heuristic
	$(BIN)/frugal train mde --data data/narrow-v1 --model learned --deviations models/narrow/learned/deviations.npz --out models/narrow/mde_learned

benchmark: $(VENV)/ready  ## accuracy, speed-up and overhead of the whole system; the optimiser beside scikit-learn and BoTorch
	$(BIN)/python -m benchmarks.system
	$(BIN)/frugal bench optimizer

clean:
	rm -rf $(VENV) out build *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
