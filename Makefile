# make demo: film two trained agents, train two algorithms for a minute, report.
# make test: run the tests.
# make check: make slow (slow tests, among them installations in environments of their own), make docs.
# make docs: build the documentation: docs/_build/html/index.html.
# make results: the pages of the published runs, results/**/index.html, from their archives.
# make integrate: install [integrations] and [tianshou] as well, and run the tests against other libraries.
# make ray: install [ray] as well, and kill nodes and drivers of clusters, six minutes.
# make faults: kill, damage, fill and mistype thousands of times, about 25 minutes on a core; prints what
# was tried and what was wrong (docs/faults.md).
# make peers PEER=checkout: run safety-gymnasium's own tests, of a checkout, on the tasks here.
# Each builds .venv first; Python 3.11 or newer is all they need.

PYTHON ?= python3
VENV ?= .venv
BIN := $(abspath $(VENV)/bin)
# Python compiles what it imports, once, where it may keep it: without, each process here compiles
# torch again, which takes longer than most tests. Compiling all that is installed takes longer still.
unexport PYTHONDONTWRITEBYTECODE
PIP := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check
# PyTorch without CUDA, some gigabytes less, where its index answers at once.
CPU_WHEELS := https://download.pytorch.org/whl/cpu
ANSWERS = import urllib.request as r; r.urlopen("$(CPU_WHEELS)/torch/", timeout=3)
INSTALL = $(PIP) -c constraints.txt \
	$(shell $(PYTHON) -c '$(ANSWERS)' 2>/dev/null && echo --extra-index-url $(CPU_WHEELS))

.PHONY: demo test check slow docs results faults integrate lint peers ray clean
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

# Folders of policies to film side by side before anything is trained, and their titles.
DEMO_POLICIES ?= pretrained:cpo/SafetyPointGoal1-v0 pretrained:zoo/SafetyPointGoal1-v0
DEMO_TITLES ?= "CPO: above the limit of 25" "the zoo: within it"
# Trained together, by one process each where there are two cores.
DEMO_ALGORITHMS ?= trpo-lag cpo
DEMO_TASK ?= Circle2D-1-v0
DEMO_STEPS ?= 100000
# Filmed beside them: what the package's own training of a million steps reaches. Empty for a task
# that the zoo lacks.
DEMO_BESIDE ?= pretrained:zoo/$(DEMO_TASK)
DEMO_BESIDE_TITLE ?= "the zoo: 1000000 steps"
DEMO := runs/demo

demo: $(VENV)/trains
	rm -rf $(DEMO)
ifneq ($(strip $(DEMO_POLICIES)),)
	$(BIN)/circle2d render $(DEMO_POLICIES) --names $(DEMO_TITLES) --episodes 1 --size 320 \
		--frames mujoco --every 8 --out $(DEMO)/trained.gif
endif
	$(BIN)/circle2d reproduce --algorithms $(DEMO_ALGORITHMS) --tasks $(DEMO_TASK) \
		--steps $(DEMO_STEPS) --width 80 --out $(DEMO)
	-$(BIN)/circle2d render $(addprefix $(DEMO)/$(DEMO_TASK)/,$(DEMO_ALGORITHMS)) $(DEMO_BESIDE) \
		--names $(DEMO_ALGORITHMS:%="%: $(DEMO_STEPS) steps") $(if $(DEMO_BESIDE),$(DEMO_BESIDE_TITLE)) \
		--episodes 2 --size 320 --out $(DEMO)/film.gif
	@echo "The report: $(abspath $(DEMO))/index.html"

# Files in their order, trainings first: by count of tests, few long ones would come last, alone.
test: $(VENV)/develops
	$(BIN)/python -m pytest -n logical --dist loadfile --no-loadscope-reorder

check: slow docs

# A worker without tests takes over half of another's: single tests here take minutes.
slow: $(VENV)/develops
	$(BIN)/python -m pytest -m slow -n logical --dist worksteal --durations 20

docs: $(VENV)/develops
	$(BIN)/python -m sphinx -W --keep-going --quiet -b html -d docs/_build/doctrees docs docs/_build/html
	@echo "The documentation: $(abspath docs/_build/html/index.html)"

# Status 1 of a report says that it names runs which failed.
LEVELS := 0 1 2 3
OF_PAPER := trpo-lag cpo sac-lag sac-lb wcsac
BESIDE := $(LEVELS:%=results/solve/runs.zip/Circle2D-%-v0-sac-lb-streak)
BESIDE += $(foreach n,$(LEVELS),$(OF_PAPER:%=results/circle2d/runs.zip/Circle2D-$n-v0/%))
# In the page's order of tasks.
ON_SAFETY := runs sac-pid-cal half-cheetah push-trust-region push-others button-nine button-others car
REPORT := $(BIN)/circle2d report

results: $(VENV)/trains
	-$(REPORT) results/circle2d/runs.zip results/circle2d/bootstrap.zip --out results/circle2d
	-$(REPORT) results/baselines/runs.zip results/baselines/sac-pid-cal.zip $(BESIDE) \
		--out results/baselines
	-cd examples && $(REPORT) ../results/library/*.zip --import library_cpo \
		--import library_sac_lag --out ../results/library
	-$(REPORT) $(ON_SAFETY:%=results/baselines/safety/%.zip) --out results/baselines/safety
	for folder in physics safety sensitivity solve solve/safety; do \
		$(REPORT) results/$$folder/*.zip --out results/$$folder; done

INTEGRATED := $(addprefix tests/emcc/test_emcc_,minari.py sb3.py tensordict.py) tests/test_examples.py
INTEGRATED += tests/agents/test_export.py tests/circle2d_mj/core/test_other_libraries.py
INTEGRATED += tests/agents/test_sweeps.py::test_training_on_ray

# All that is pinned but pandas and filelock, of which tianshou needs versions before 3 and 4. It puts
# these libraries into the same environment. The test on Ray is a slow one.
integrate: $(VENV)/develops
	sed -e 's/^pandas==.*/pandas<3/' -e 's/^filelock==.*/filelock<4/' constraints.txt \
		> $(VENV)/constraints.txt
	$(PIP) -c $(VENV)/constraints.txt -e '.[dev,integrations,tianshou]'
	$(BIN)/python -m pytest -m "slow or not slow" -n logical --durations 5 $(INTEGRATED)

ray: $(VENV)/develops
	$(INSTALL) -e '.[dev,ray]'
	$(BIN)/python -m pytest -m slow -k "ray and not array" tests/agents

faults: $(VENV)/develops
	OMP_NUM_THREADS=1 $(BIN)/python tests/faults/run.py

peers: $(VENV)/develops
	$(BIN)/python tests/peers/run.py $(PEER)

lint: $(VENV)/develops
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

clean:
	rm -rf $(VENV) runs/demo docs/_build docs/made
