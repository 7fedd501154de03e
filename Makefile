# The map of the data flow: each target below is one arrow of the design, in its order.
#
#   trials -> plant -> bundle (+ observer unit) -> twin unit -> software in the loop -> report

PYTHON ?= python3
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

BIN := .venv/bin
READY := .venv/.ready
SEED ?= 1

# Run one command of ours, show it, and keep it for the report.
define run
@mkdir -p build && echo "$(1)" >> build/commands.log && echo "\$$ $(1)"
@PATH="$(CURDIR)/$(BIN):$$PATH" $(1)
endef

# The same for a command whose verdict belongs into the report, good or bad (exit 1 and 3).
judge = $(call run,$(1)) || [ $$? -ne 2 ]

.PHONY: help setup demo test lint sil faults mutate soak hitl hitl-emulated bench lock clean
.DELETE_ON_ERROR:
.SECONDARY:

help:
	@echo "make demo    the main job end to end; ends by naming the report to open"
	@echo "make test    lint, types, import contract and tests"
	@echo "make sil     the loop in software for 10 s, its timing judged"
	@echo "make soak    the same for 28 minutes under load with faults on the wire"
	@echo "make faults  every fault injected and judged, three minutes"
	@echo "make mutate  every comparison of the safety supervisor changed: do the tests notice?"
	@echo "make hitl    tests on a real servo at DROPSTITCH_HITL_PORT; hitl-emulated: without one"
	@echo "make bench   ratios against peers, measured side by side"
	@echo "make lock    renew requirements/ from pyproject.toml"
	@echo "make clean   remove what was built (keeps .venv)"

# --- set-up -------------------------------------------------------------------------------------

setup: $(READY)

$(READY): requirements/workshop.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "dropstitch needs Python 3.11 or newer: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@if command -v uv >/dev/null; then \
	  uv venv --quiet --allow-existing --python $(PYTHON) .venv && \
	  uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements/workshop.txt && \
	  uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation -e . ; \
	else \
	  $(PYTHON) -c 'import ensurepip' 2>/dev/null || \
	    { echo "Python's venv is incomplete here: apt install python3-venv, then make again"; exit 1; }; \
	  echo "setting up .venv (1.5 GB, a minute or two)"; \
	  $(PYTHON) -m venv .venv && \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes \
	    -r requirements/workshop.txt && \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	    --no-build-isolation -e . ; \
	fi
	@touch $@

# --- the main job -------------------------------------------------------------------------------

demo: build/report.html
	@echo
	@echo "open $(CURDIR)/build/report.html"

# The paper gives no phase between the joints of 2DOF: both ends of its range are run.
build/trials/.done: | $(READY)
	$(call run,python -m models simulate --out $(@D) --dof 1 2 --seed $(SEED))
	$(call run,python -m models simulate --out $(@D) --dof 2 --phase-deg 90 --seed $(SEED))
	@touch $@

build/unseen_20deg/.done: | $(READY)
	$(call run,python -m models simulate --out $(@D) --dof 1 2 --amplitude-deg 20 --trials 1 --seed $(SEED))
	$(call run,python -m models simulate --out $(@D) --dof 2 --phase-deg 90 --amplitude-deg 20 --trials 1 --seed $(SEED))
	@touch $@

build/unseen_multisine/.done: | $(READY)
	$(call run,python -m models simulate --out $(@D) --dof 1 2 --motion multisine --payloads 0 1 2 --trials 1 --seed $(SEED))
	@touch $@

build/plant.json: build/trials/.done
	$(call run,python -m models identify build/trials --plant models/plant/nominal.toml --out $@)

# After training the observer unit goes into the bundle, so the bundle is done when it is there.
build/bundle_%dof/observer.fmu: build/plant.json build/unseen_20deg/.done
	$(call run,python -m models train build/trials --dof $* --plant build/plant.json --unseen build/unseen_20deg --out $(@D))
	$(call run,python -m fmu build $(@D) --plant build/plant.json --unit observer --out $@)

# Studies of one phase each, for the report alone: the robot's bundle is trained on both.
build/study_2dof_phase%/study.json: build/plant.json build/unseen_20deg/.done
	$(call run,python -m models train build/trials --dof 2 --phase-deg $* --plant build/plant.json --unseen build/unseen_20deg --out $(@D))

build/twin_%dof.fmu: build/bundle_%dof/observer.fmu
	$(call run,python -m fmu build build/bundle_$*dof --plant build/plant.json --out $@)

build/check_twin_%dof.json: build/twin_%dof.fmu
	$(call judge,python -m fmu check $< --json > $@)

build/evaluate_%.json: build/%/.done build/plant.json
	$(call run,python -m models evaluate build/$* --plant build/plant.json --json > $@)

build/sil_%dof/timing.json: build/twin_%dof.fmu
	$(call judge,python -m hil sil --bundle build/bundle_$*dof --fmu $< --line virtual --seconds 60 --out $(@D))

build/sil_2dof_phase90/timing.json: build/twin_2dof.fmu
	$(call judge,python -m hil sil --bundle build/bundle_2dof --fmu $< --phase-deg 90 --line virtual --seconds 60 --out $(@D))

build/sil/timing.json: build/twin_1dof.fmu
	$(call judge,python -m hil sil --bundle build/bundle_1dof --fmu $< --line socket --seconds 10 --out $(@D))

REPORT_PARTS := $(foreach dof,1 2,build/check_twin_$(dof)dof.json build/sil_$(dof)dof/timing.json) \
  $(foreach phase,0 90,build/study_2dof_phase$(phase)/study.json) \
  $(foreach motion,20deg multisine,build/evaluate_unseen_$(motion).json) \
  build/sil_2dof_phase90/timing.json build/sil/timing.json

build/report.html: $(REPORT_PARTS)
	$(call run,python -m hil report --build build --out $@)

# --- checks -------------------------------------------------------------------------------------

test: lint
	$(BIN)/python -m pytest -n 2

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

sil: build/twin_1dof.fmu
	$(call run,python -m hil sil --bundle build/bundle_1dof --fmu $< --line socket --seconds 10 --out build/sil)

# 100,000 ticks under load with lost and damaged replies: 28 minutes.
soak: build/twin_2dof.fmu
	$(call run,python -m hil sil --bundle build/bundle_2dof --fmu $< --line socket --seconds 1700 \
	  --load 1 --faults lost=0.01 corrupt=0.01 --out build/soak)

# The same tests at DROPSTITCH_HITL_PORT, a real servo's port, and at an emulated one's.
hitl: $(READY)
	@test -n "$$DROPSTITCH_HITL_PORT" || \
	  { echo "set DROPSTITCH_HITL_PORT to the port of a real servo (docs/robot.md)"; exit 2; }
	$(BIN)/python -m pytest tests/hitl

hitl-emulated: $(READY)
	$(BIN)/python -m tests.hitl.emulated

faults: build/twin_2dof.fmu
	$(call judge,python -m hil faults --bundle build/bundle_2dof --fmu $< --out build/faults)

mutate: $(READY)
	$(BIN)/python tests/firmware_py/mutation.py

bench: build/twin_2dof.fmu
	$(BIN)/python -m bench.onnx
	$(BIN)/python -m bench.loop --bundle build/bundle_2dof --fmu $<

lock:
	for extra in record:robot test:workshop; do \
	  uv pip compile pyproject.toml --quiet --universal --python-version 3.11 --generate-hashes \
	    --no-emit-index-url --no-annotate --custom-compile-command "make lock" \
	    --extra $${extra%%:*} --output-file requirements/$${extra##*:}.txt; done

clean:
	rm -rf build
