# make demo   build the environment and run the main job on the example scenes
# make test   lint, type-check and run the whole test suite
# make hard   the hard cases of simulation, one table; then the random tests on fresh numbers
# make bench  speed, each figure a ratio to a yardstick measured in the same run
# make pictures  the pictures of the example scenes in the README, again
# make peers  agreement and speed beside engines that others wrote, in an environment of their own

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

# the workers of a test run share the processors: threads of the matrix library would only wait
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS      := 1
# and the commands that tests start are compiled once, whatever the environment says
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test hard bench pictures peers clean

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("robodyn needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --config-settings editable_mode=compat --editable '.[dev]'
	touch $@

demo: $(READY)
	$(BIN)/robodyn torque robots/2r.yaml --q 30deg,45deg --qd 1,0.5 --qdd 0,0
	$(BIN)/robodyn torque robots/four-bar.yaml --q 60deg --qd 5 --qdd 0
	$(BIN)/robodyn simulate robots/four-bar.yaml --q 60deg --tau "2*sin(3*t)" --time 2 --points 5
	@echo "The command is $(BIN)/robodyn; it lists what it does: $(BIN)/robodyn --help"

test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

hard: $(READY)
	$(BIN)/python tests/hard_cases/run.py
	FRESH=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder $$(grep -lE "FRESH|hypothesis|mark.thinned" tests/test_*.py)

bench: $(READY)
	$(BIN)/python tests/bench.py

PICTURES := robots/pictures
DRAW     := $(BIN)/robodyn draw --size 3.2x2.4 --dpi 300

pictures: $(READY)
	mkdir -p bench
	for scene in robots/*.yaml; do \
		$(DRAW) "$$scene" --labels names $$(sed -n 's/ --qd.*//; s/^# try: //p' "$$scene") \
		-o $(PICTURES)/$$(basename "$$scene" .yaml).png || exit; \
	done
	$(BIN)/robodyn draw robots/four-bar.yaml --q 60deg --qd 5 --forces --dpi 200 --size 4.8x3.6 \
		-o $(PICTURES)/forces.png
	(echo q1; seq 0 1.0472 5.3) | $(DRAW) robots/slider-crank.yaml - -o $(PICTURES)/poses.png
	$(BIN)/robodyn sweep robots/2r.yaml --vary q1=-269.25deg:89.25deg:240 \
		--vary q2=-179deg:179.5deg:240 --rtol 1e-6 --atol 1e-6 --result flip -o bench/flips.csv
	$(BIN)/robodyn plot bench/flips.csv --x q1 --y q2 --colour flip --log --size 7x6 --dpi 300 \
		-o $(PICTURES)/flip-map.png

PEERS := .venv-peers

$(PEERS)/.ready: pyproject.toml tests/peers/requirements.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --config-settings editable_mode=compat --editable '.[fast]'
	while read -r peer; do \
		$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --only-binary :all: "$$peer" \
		|| echo "$$peer cannot be installed, goes on without" >&2; \
	done < tests/peers/requirements.txt
	touch $@

peers: $(PEERS)/.ready
	PYTHONPATH=tests $(PEERS)/bin/python -m peers

clean:
	rm -rf $(VENV) $(PEERS) bench build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
