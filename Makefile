# The map of the data flow: each target below is one arrow of the design, in its order.
#
#   trials -> plant -> bundle (+ observer unit) -> twin unit -> software in the loop -> report

PYTHON ?= python3
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

BIN := .venv/bin
READY := .venv/.ready
SEED ?= 1

# What gap-demo hides in the laboratory: EFFECT=STRENGTH, several with spaces between them.
HIDE ?= stiffness_softening=0.15
SPACE := $() $()
GAP := build/gap_demo/$(subst $(SPACE),+,$(subst =,_,$(strip $(HIDE))))
HIDDEN := $(foreach effect,$(HIDE),--hide $(effect))

# Run one command of ours, show it, and keep it for the report that it belongs to.
LOG = $(if $(filter $(GAP)/%,$@),$(GAP),build)/commands.log

define run
@mkdir -p $(dir $(LOG)) && echo "$(1)" >> $(LOG) && echo "\$$ $(1)"
@PATH="$(CURDIR)/$(BIN):$$PATH" $(1)
endef

# The same for a command whose verdict belongs into the report, good or bad (exit 1 and 3).
judge = $(call run,$(1)) || [ $$? -ne 2 ]

.PHONY: help setup demo gap-demo test lint sil faults mutate soak hitl hitl-emulated bench bench-real lock clean
.DELETE_ON_ERROR:
.SECONDARY:

help:
	@echo "make demo    the main job end to end; ends by naming the report to open"
	@echo "make gap-demo HIDE=$(HIDE)"
	@echo "             hide an effect in the laboratory, find and add it, rebuild unit and bundle,"
	@echo "             run the robot again; ends by naming the report of before and after"
	@echo "make test    lint, types, import contract and tests"
	@echo "make sil     the loop in software for 10 s, its timing judged"
	@echo "make soak    the same for 28 minutes under load with faults on the wire"
	@echo "make faults  every fault injected and judged, three minutes"
	@echo "make mutate  every comparison of the safety supervisor changed: do the tests notice?"
	@echo "make hitl    tests on a real servo at DROPSTITCH_HITL_PORT; hitl-emulated: without one"
	@echo "make bench   ratios against peers, measured side by side"
	@echo "make bench-real DATA=DIR  measured data of two other rigs: name what their plants lack"
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

build/sil_socket_2dof/timing.json: build/twin_2dof.fmu
	$(call judge,python -m hil sil --bundle build/bundle_2dof --fmu $< --line socket --seconds 10 --out $(@D))

REPORT_PARTS := $(foreach dof,1 2,build/check_twin_$(dof)dof.json build/sil_$(dof)dof/timing.json) \
  $(foreach phase,0 90,build/study_2dof_phase$(phase)/study.json) \
  $(foreach motion,20deg multisine,build/evaluate_unseen_$(motion).json) \
  build/sil_2dof_phase90/timing.json build/sil/timing.json build/sil_socket_2dof/timing.json

build/report.html: $(REPORT_PARTS)
	$(call run,python -m hil report --build build --out $@)

# --- the gap workflow ---------------------------------------------------------------------------

# Three payloads. The gap is looked for in the study's motion and judged on another, where the
# trials differ from those of build/unseen_multisine in nothing but the effect.
GAP_PAYLOADS := 0 1 2

gap-demo: $(GAP)/report.html
	@echo
	@echo "open $(CURDIR)/$<"

$(GAP)/trials/.done: | $(READY)
	$(call run,python -m models simulate --out $(@D) --payloads $(GAP_PAYLOADS) --seed 3 $(HIDDEN))
	@touch $@

$(GAP)/sealed/.done: | $(READY)
	$(call run,python -m models simulate --out $(@D) --motion multisine --payloads $(GAP_PAYLOADS) --trials 1 --seed $(SEED) $(HIDDEN))
	@touch $@

$(GAP)/found/plant.json: $(GAP)/trials/.done build/plant.json
	$(call judge,python -m models gap $(<D) --plant build/plant.json --out $(@D))

$(GAP)/bundle_after/observer.fmu: PLANT := $(GAP)/found/plant.json
$(GAP)/bundle_retrained/observer.fmu: PLANT := build/plant.json
$(GAP)/bundle_%/observer.fmu: $(GAP)/found/plant.json $(GAP)/sealed/.done
	$(call run,python -m models train $(GAP)/trials --dof 1 --plant $(PLANT) --unseen $(GAP)/sealed --out $(@D))
	$(call run,python -m fmu build $(@D) --plant $(PLANT) --unit observer --out $@)

$(GAP)/twin_1dof.fmu: $(GAP)/bundle_after/observer.fmu
	$(call run,python -m fmu build $(<D) --plant $(GAP)/found/plant.json --out $@)

$(GAP)/check_twin_1dof.json: $(GAP)/twin_1dof.fmu
	$(call judge,python -m fmu check $< --json > $@)

# Both units in FMPy on the sealed trials, and the one before on the same without the effect.
in_fmpy = $(call run,python -m fmu simulate $(1) --trial $(2)/dof1_payload$*_trial1_multisine_30deg.csv --out $(basename $@) --json > $@)

$(GAP)/fmpy_before_%.json: build/twin_1dof.fmu $(GAP)/sealed/.done
	$(call in_fmpy,$<,$(GAP)/sealed)
$(GAP)/fmpy_after_%.json: $(GAP)/twin_1dof.fmu $(GAP)/sealed/.done
	$(call in_fmpy,$<,$(GAP)/sealed)
$(GAP)/fmpy_without_%.json: build/twin_1dof.fmu build/unseen_multisine/.done
	$(call in_fmpy,$<,build/unseen_multisine)

# The robot's loop with every bundle, the laboratory behind its servos.
on_robot = $(call judge,python -m hil sil --bundle $(<D) --rig $(1) --payload-kg $* --line virtual --seconds 24 --out $(@D))

$(GAP)/sil_before_%/timing.json: build/bundle_1dof/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_retrained_%/timing.json: $(GAP)/bundle_retrained/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_after_%/timing.json: $(GAP)/bundle_after/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_without_%/timing.json: build/bundle_1dof/observer.fmu
	$(call on_robot)

GAP_PARTS := $(GAP)/found/plant.json $(GAP)/check_twin_1dof.json \
  $(foreach kg,$(GAP_PAYLOADS),$(foreach unit,before after without,$(GAP)/fmpy_$(unit)_$(kg).json) \
  $(foreach bundle,before retrained after without,$(GAP)/sil_$(bundle)_$(kg)/timing.json))

$(GAP)/report.html: $(GAP_PARTS)
	$(call run,python -m hil gap $(@D) --plant build/plant.json $(HIDDEN) --out $@)

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
	$(BIN)/python tests/firmware_py/safety/mutation.py

bench: build/twin_2dof.fmu
	$(BIN)/python -m bench.onnx
	$(BIN)/python -m bench.sdk_loop --bundle build/bundle_2dof --fmu $<

bench-real: $(READY)
	$(BIN)/python -m bench.real $(DATA)

lock:
	for extra in record:robot test:workshop; do \
	  uv pip compile pyproject.toml --quiet --universal --python-version 3.11 --generate-hashes \
	    --no-emit-index-url --no-annotate --custom-compile-command "make lock" \
	    --extra $${extra%%:*} --output-file requirements/$${extra##*:}.txt; done

clean:
	rm -rf build
