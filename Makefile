# make demo: train TRPO-Lag on Circle2D-1 for a minute or two; tables, heat map, trajectories.
# make test: run the tests, at most six minutes on two cores.
# make check: run the slow tests; among them installations in environments of their own.
# make integrate: install [integrations] as well, and run the tests against other libraries.
# make faults: kill, damage, fill and mistype thousands of times, about 25 minutes on a core; prints what
# was tried and what was wrong (docs/faults.md).
# Each builds .venv first; Python 3.11 or newer is all they need.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test check faults integrate lint clean
.DELETE_ON_ERROR:

$(VENV)/made:
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/trains: $(VENV)/made pyproject.toml constraints.txt
	$(INSTALL) -e '.[train]'
	touch $@

$(VENV)/develops: $(VENV)/made pyproject.toml constraints.txt
	$(INSTALL) -e '.[dev]'
	touch $@

demo: $(VENV)/trains
	rm -rf runs/demo
	$(BIN)/circle2d train --algorithm trpo-lag --task Circle2D-1-v0 --seeds 0 1 2 --steps 250000 \
		--backend eager --out runs/demo
	$(BIN)/python -m emcc runs/demo --per-run
	$(BIN)/circle2d report runs/demo > runs/demo/report.txt
	-$(BIN)/circle2d render runs/demo
	@echo "The report, with training curves and heat map: runs/demo/index.html"

test: $(VENV)/develops
	$(BIN)/python -m pytest -n logical --dist loadfile

check: $(VENV)/develops
	$(BIN)/python -m pytest -m slow -n logical --dist loadfile --durations 20

# All that is pinned but pandas, of which tianshou needs version 2. Last of all in .ci/run, since it
# puts these libraries into the same environment.
integrate: $(VENV)/develops
	grep -v '^pandas==' constraints.txt > $(VENV)/constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c $(VENV)/constraints.txt \
		-e '.[dev,integrations]'
	$(BIN)/python -m pytest -n logical --durations 5 tests/emcc tests/agents/test_export.py \
		tests/circle2d_mj/core/test_other_libraries.py tests/test_examples.py
	$(BIN)/python -m pytest -m slow tests/agents/training/test_ray.py tests/agents/test_sweeps.py

faults: $(VENV)/develops
	OMP_NUM_THREADS=1 $(BIN)/python tests/faults/run.py

lint: $(VENV)/develops
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

clean:
	rm -rf $(VENV) runs/demo
