# The commands of this repository. `make help` lists the targets.
#
# Files are made in the order of the data:
#
#   trials -> plant -> bundle -> observer and twin as FMUs -> loop in software -> report
#
# Each recipe is one command of `dropstitch`, which also works when you type it.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
COMPLETE := .venv/.complete
SEED ?= 1

# FMUs are dated to the last commit, so that two builds give the same bytes.
ifndef SOURCE_DATE_EPOCH
SOURCE_DATE_EPOCH := $(shell git log -1 --format=%ct 2>/dev/null || date +%s)
endif
export SOURCE_DATE_EPOCH

# One thread for each process: two processes at a time use two cores.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

# Compiled Python is always written, and to build/: compiling it anew costs each command seconds.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/build/cache/python

# Print a command, run it, and log it for the report of its directory.
LOG = $(firstword $(foreach directory,$(GAP) $(STUDY),$(if $(filter $(directory)/%,$@),$(directory))) build)/commands.log

define run
@mkdir -p $(dir $(LOG)) && echo "$(1)" >> $(LOG) && echo "\$$ $(1)"
@PATH="$(CURDIR)/$(BIN):$$PATH" $(1)
endef

# The same where a bad verdict (exit codes 1 and 3) is a result that the report shows.
judge = $(call run,$(1)) || case $$? in 1|3) ;; *) exit 2 ;; esac

.PHONY: help help-all setup demo study gap-demo tip-demo test test-all sil figures docs clean lint pytest \
  mutate experiment-demo link-demo fmu-all ssp faults recorded-runs soak fuzz fuzz-fmu hitl \
  hitl-emulated wheelhouse lock
.DELETE_ON_ERROR:
.SECONDARY:

help:
	@echo "make demo       from trials to the report; 4 minutes, 1.2 GB for .venv the first time"
	@echo "make study      the paper's study: five payloads, two phases, all predictors; 4 minutes"
	@echo "make gap-demo HIDE=$(HIDE)   hides an effect, finds it, improves plant and robot; 3 minutes more"
	@echo "make tip-demo   leads the tip along a line and a circle; 2 minutes after the demo"
	@echo "make sil        the robot's loop in real time for 10 s, with a timing verdict; 1 minute"
	@echo "make setup      .venv with what tests and documents need, 1.9 GB; 2 minutes"
	@echo "make test       lint, types and the quick tests; 5 minutes"
	@echo "make figures    measures docs/figures.md; 45 minutes. ONLY='tip loop' measures parts"
	@echo "make docs       the documentation as a site"
	@echo "make help-all   the other targets"

help-all: help
	@echo
	@echo "make clean      removes build/"
	@echo "make test-all   make test with the slow tests; 15 minutes"
	@echo "make lint       ruff, mypy and import contracts; make pytest: the tests alone"
	@echo "make experiment-demo HIDE=encoder_offset=0.02   a motion that separates look-alikes; 5 minutes"
	@echo "make link-demo  another link: from its description to the robot's loop; 1 minute"
	@echo "make faults     every fault injected and judged; 10 minutes after the demo"
	@echo "make soak       the loop for 28 minutes under load with faults on the line"
	@echo "make fmu-all    FMUs for five platforms and both FMI versions, their sources, and SSP packages"
	@echo "make ssp        twin, observer and controller as one SSP package"
	@echo "make fuzz       mutated files for every reader, 10 minutes"
	@echo "make fuzz-fmu   random calls of FMUs under sanitizers, 10 minutes"
	@echo "make mutate     mutants of the code that the tests have to notice, an hour (ONLY, SEED, COUNT)"
	@echo "make hitl       tests on a real servo at DROPSTITCH_HITL_PORT; hitl-emulated: on an emulated one"
	@echo "make recorded-runs   records again the runs that every change must reproduce"
	@echo "make wheelhouse the wheels for a robot PC without network"
	@echo "make lock       renews requirements/ from pyproject.toml"

# --- set-up --------------------------------------------------------------------------------------

setup: $(COMPLETE)

# The lock files are complete, so nothing is resolved. uv is faster; pip serves where uv fails, as
# behind an index that only pip knows.
UV = uv pip install --quiet --no-deps --python $(BIN)/python
PIP = $(BIN)/python -m pip install --quiet --no-deps --no-compile --disable-pip-version-check

define install
@export PATH="$$PATH:$(CURDIR)/$(BIN)"; $(UV) $(1) || \
  { $(BIN)/python -m pip --version >/dev/null 2>&1 && $(PIP) $(1); }
endef

# What the demos need.
$(READY): requirements/workshop.txt requirements/uv.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "dropstitch needs Python 3.11 or newer: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@echo "setting up .venv: 1.2 GB, about a minute"
	@if command -v uv >/dev/null; then uv venv --quiet --allow-existing --python $(PYTHON) .venv; else \
	  $(PYTHON) -c 'import ensurepip' 2>/dev/null || \
	    { echo "Python's venv is incomplete here: apt install python3-venv, then make again"; exit 1; }; \
	  $(PYTHON) -m venv .venv && { $(PIP) --require-hashes -r requirements/uv.txt || true; }; \
	fi
	$(call install,--require-hashes -r requirements/workshop.txt)
	$(call install,--no-build-isolation -e .)
	@touch $@

# What tests, lint, figures and documents need besides: 0.6 GB.
$(COMPLETE): requirements/test.txt $(READY)
	@echo "adding what tests and documents need: 0.6 GB, about a minute"
	$(call install,--require-hashes -r requirements/test.txt)
	@touch $@

# --- demo ----------------------------------------------------------------------------------------

# bench/demo.py makes the files below stage by stage, and prints a line for each.
demo:
	@echo "From trials to the robot's loop: about 4 minutes on two idle cores, a third of it for .venv."
	@$(MAKE) --silent --no-print-directory $(READY)
	@$(BIN)/python -m bench.demo demo
	@echo
	@echo "open $(CURDIR)/build/report.html"

# Joint 2 leads by 90 degrees: joints that always move together cannot be told apart.
build/trials/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --dof 1 2 --phase-deg 90 --payloads 0 1 2 --seed $(SEED))
	@touch $@

# A motion that the plant is not fitted to. The robot's predictor is trained on it, too.
build/unseen_multisine/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --dof 1 2 --motion multisine --payloads 0 1 2 --trials 1 --seed $(SEED))
	@touch $@

build/plant.json: build/trials/.done
	$(call run,dropstitch identify $(<D) --plant models/plant/nominal.toml --out $@)

build/bundle_%dof/predictor.onnx: build/plant.json build/unseen_multisine/.done
	$(call run,dropstitch train build/trials --dof $* --plant $< --motions build/unseen_multisine --out $(@D))

# The observer goes into the bundle, so it is the last file of a bundle.
build/bundle_%dof/observer.fmu: build/bundle_%dof/predictor.onnx
	$(call run,dropstitch fmu build $(@D) --plant build/plant.json --unit observer --out $@)

build/twin_%dof.fmu: build/bundle_%dof/observer.fmu
	$(call run,dropstitch fmu build $(<D) --plant build/plant.json --out $@)

build/check_twin_%dof.json: build/twin_%dof.fmu
	$(call judge,dropstitch fmu check $< --json > $@)

build/sil_%dof/timing.json: build/twin_%dof.fmu
	$(call judge,dropstitch sil --bundle build/bundle_$*dof --fmu $< --line virtual --seconds 60 --out $(@D))

build/sil/timing.json: build/twin_1dof.fmu
	$(call judge,dropstitch sil --bundle build/bundle_1dof --fmu $< --line socket --seconds 10 --miss-rate 0.01 --out $(@D))

build/report.html: $(foreach dof,1 2,build/check_twin_$(dof)dof.json build/sil_$(dof)dof/timing.json) build/sil/timing.json
	$(call run,dropstitch report build build --out $@)

# --- study ---------------------------------------------------------------------------------------

# The paper does not state the phase between the joints: 0 and 90 degrees are run. Plant and
# predictor are those of the study's own trials, and all candidates for the predictor are compared.
STUDY := build/study

study: | $(READY)
	@echo "The paper's study on simulated trials: about 4 minutes on two idle cores."
	@$(BIN)/python -m bench.demo study
	@echo
	@echo "open $(CURDIR)/$(STUDY)/report.html"

$(STUDY)/trials/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --dof 1 2 --seed $(SEED))
	$(call run,dropstitch simulate --out $(@D) --dof 2 --phase-deg 90 --seed $(SEED))
	@touch $@

$(STUDY)/unseen_20deg/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --dof 1 2 --amplitude-deg 20 --trials 1 --seed $(SEED))
	$(call run,dropstitch simulate --out $(@D) --dof 2 --phase-deg 90 --amplitude-deg 20 --trials 1 --seed $(SEED))
	@touch $@

$(STUDY)/plant.json: $(STUDY)/trials/.done
	$(call run,dropstitch identify $(<D) --plant models/plant/nominal.toml --out $@)

$(STUDY)/bundle_%dof/predictor.onnx: $(STUDY)/plant.json $(STUDY)/unseen_20deg/.done build/unseen_multisine/.done
	$(call run,dropstitch train $(STUDY)/trials --dof $* --plant $< --unseen $(STUDY)/unseen_20deg --motions build/unseen_multisine --compare --study --out $(@D))

$(STUDY)/bundle_%dof/observer.fmu: $(STUDY)/bundle_%dof/predictor.onnx
	$(call run,dropstitch fmu build $(@D) --plant $(STUDY)/plant.json --unit observer --out $@)

# Studies of one phase, for the report: the bundle's study has both.
$(STUDY)/study_2dof_phase%/study.json: $(STUDY)/plant.json $(STUDY)/unseen_20deg/.done
	$(call run,dropstitch train $(STUDY)/trials --dof 2 --phase-deg $* --plant $< --unseen $(STUDY)/unseen_20deg --study-only --out $(@D))

$(STUDY)/evaluate_unseen_20deg.json: $(STUDY)/plant.json $(STUDY)/unseen_20deg/.done
	$(call run,dropstitch evaluate $(STUDY)/unseen_20deg --plant $< --json > $@)

$(STUDY)/evaluate_unseen_multisine.json: $(STUDY)/plant.json build/unseen_multisine/.done
	$(call run,dropstitch evaluate build/unseen_multisine --plant $< --json > $@)

$(STUDY)/sil_2dof_phase%/timing.json: $(STUDY)/bundle_2dof/observer.fmu
	$(call judge,dropstitch sil --bundle $(<D) --phase-deg $* --line virtual --seconds 60 --out $(@D))

$(STUDY)/sil_socket_2dof/timing.json: $(STUDY)/bundle_2dof/observer.fmu
	$(call judge,dropstitch sil --bundle $(<D) --line socket --seconds 10 --miss-rate 0.01 --out $(@D))

$(STUDY)/report.html: $(STUDY)/bundle_1dof/observer.fmu $(STUDY)/sil_socket_2dof/timing.json \
  $(foreach phase,0 90,$(STUDY)/study_2dof_phase$(phase)/study.json $(STUDY)/sil_2dof_phase$(phase)/timing.json) \
  $(foreach motion,20deg multisine,$(STUDY)/evaluate_unseen_$(motion).json)
	$(call run,dropstitch report build $(STUDY) --out $@)

# --- gap demo ------------------------------------------------------------------------------------

# Effects that gap-demo hides in the rig: EFFECT=STRENGTH, separated by spaces.
HIDE ?= stiffness_softening=0.15
SPACE := $() $()
GAP := build/gap_demo/$(subst $(SPACE),+,$(subst =,_,$(strip $(HIDE))))
HIDDEN := $(foreach effect,$(HIDE),--hide $(effect))

# Three payloads. The gap is searched in trials of the study's motion and judged on trials of a
# multisine, which differ from those of build/unseen_multisine only by the hidden effect.
GAP_PAYLOADS := 0 1 2

gap-demo: | $(READY)
	@$(MAKE) --no-print-directory --jobs 2 $(GAP)/report.html
	@echo
	@echo "open $(CURDIR)/$(GAP)/report.html"

$(GAP)/trials/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --payloads $(GAP_PAYLOADS) --seed 3 $(HIDDEN))
	@touch $@

$(GAP)/sealed/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --motion multisine --payloads $(GAP_PAYLOADS) --trials 1 --seed $(SEED) $(HIDDEN))
	@touch $@

$(GAP)/found/plant.json: $(GAP)/trials/.done build/plant.json
	$(call judge,dropstitch gap $(<D) --plant build/plant.json --out $(@D))

$(GAP)/bundle_after/observer.fmu: PLANT := $(GAP)/found/plant.json
$(GAP)/bundle_retrained/observer.fmu: PLANT := build/plant.json
$(GAP)/bundle_%/observer.fmu: $(GAP)/found/plant.json $(GAP)/sealed/.done
	$(call run,dropstitch train $(GAP)/trials --dof 1 --plant $(PLANT) --unseen $(GAP)/sealed --out $(@D))
	$(call run,dropstitch fmu build $(@D) --plant $(PLANT) --unit observer --out $@)

$(GAP)/twin_1dof.fmu: $(GAP)/bundle_after/observer.fmu
	$(call run,dropstitch fmu build $(<D) --plant $(GAP)/found/plant.json --out $@)

$(GAP)/check_twin_1dof.json: $(GAP)/twin_1dof.fmu
	$(call judge,dropstitch fmu check $< --json > $@)

# Twin FMUs before and after in FMPy on the sealed trials, and the one before without the effect.
in_fmpy = $(call run,dropstitch fmu simulate $(1) --trial $(2)/dof1_payload$*_trial1_multisine_30deg.csv --out $(basename $@) --json > $@)

$(GAP)/fmpy_before_%.json: build/twin_1dof.fmu $(GAP)/sealed/.done
	$(call in_fmpy,$<,$(GAP)/sealed)
$(GAP)/fmpy_after_%.json: $(GAP)/twin_1dof.fmu $(GAP)/sealed/.done
	$(call in_fmpy,$<,$(GAP)/sealed)
$(GAP)/fmpy_without_%.json: build/twin_1dof.fmu build/unseen_multisine/.done
	$(call in_fmpy,$<,build/unseen_multisine)

# The robot's loop with every bundle; the rig moves behind the emulated servos.
on_robot = $(call judge,dropstitch sil --bundle $(<D) --rig $(1) --payload-kg $* --line virtual --seconds 24 --out $(@D))

$(GAP)/sil_before_%/timing.json: build/bundle_1dof/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_retrained_%/timing.json: $(GAP)/bundle_retrained/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_after_%/timing.json: $(GAP)/bundle_after/observer.fmu
	$(call on_robot,$(HIDDEN))
$(GAP)/sil_without_%/timing.json: build/bundle_1dof/observer.fmu
	$(call on_robot)

# The tip on a path at the heaviest payload: rigid kinematics, the plant before and after.
GAP_PATH := line --size 0.45 --seconds 4.352 --turns 2 --payloads 2
GAP_PLANS := $(foreach variant,rigid before after without,$(GAP)/plan_$(variant)/timing.json)

$(GAP)/rigid.json: build/bundle_1dof/observer.fmu $(GAP)/found/plant.json
	$(call run,dropstitch plan $(GAP_PATH) --plant build/plant.json --bundle $(<D) --rigid --out $@)
$(GAP)/before.json: build/bundle_1dof/observer.fmu $(GAP)/found/plant.json
	$(call run,dropstitch plan $(GAP_PATH) --plant build/plant.json --bundle $(<D) --out $@)
$(GAP)/after.json: $(GAP)/bundle_after/observer.fmu
	$(call run,dropstitch plan $(GAP_PATH) --plant $(GAP)/found/plant.json --bundle $(<D) --out $@)

plan_in_gap = $(call judge,dropstitch sil --bundle $(1) --rig $(2) --seed 5 --payload-kg 2 --payload-known --line virtual --plan $< --out $(@D))

$(GAP)/plan_rigid/timing.json: $(GAP)/rigid.json
	$(call plan_in_gap,build/bundle_1dof,$(HIDDEN))
$(GAP)/plan_before/timing.json: $(GAP)/before.json
	$(call plan_in_gap,build/bundle_1dof,$(HIDDEN))
$(GAP)/plan_after/timing.json: $(GAP)/after.json
	$(call plan_in_gap,$(GAP)/bundle_after,$(HIDDEN))
$(GAP)/plan_without/timing.json: $(GAP)/before.json
	$(call plan_in_gap,build/bundle_1dof)

GAP_PARTS := $(GAP_PLANS) $(GAP)/found/plant.json $(GAP)/check_twin_1dof.json \
  $(foreach kg,$(GAP_PAYLOADS),$(foreach unit,before after without,$(GAP)/fmpy_$(unit)_$(kg).json) \
  $(foreach bundle,before retrained after without,$(GAP)/sil_$(bundle)_$(kg)/timing.json))

$(GAP)/report.html: $(GAP_PARTS)
	$(call run,dropstitch report gap $(@D) --plant build/plant.json $(HIDDEN) --out $@)

# Diagnose, rank motions, run the best, diagnose again: one payload more or less does not tell these effects apart.
experiment-demo: HIDE := $(if $(filter command line,$(origin HIDE)),$(HIDE),encoder_offset=0.02)
experiment-demo: build/plant.json
	rm -rf build/experiment/motion
	$(call run,dropstitch simulate --out build/experiment/trials --payloads $(GAP_PAYLOADS) --trials 1 --seed 7 $(foreach effect,$(HIDE),--hide $(effect)))
	$(call judge,dropstitch gap build/experiment/trials --plant build/plant.json --out build/experiment/gap)
	$(call run,dropstitch experiment --gap build/experiment/gap/gap.json --config robot.toml --out build/experiment/motion.toml --repeat --seed 7 $(foreach effect,$(HIDE),--hide $(effect)))

# --- tip demo ------------------------------------------------------------------------------------

# Each plan is run on the rig behind the emulated servos: with rigid kinematics, with a known payload,
# and with an estimated one in the second of two runs.
PLANS := build/plans
TIP_PAYLOADS := 0.7 1.8
TIP_PATH_1 := line --size 0.45 --seconds 4.352 --turns 2
TIP_PATH_2 := circle --size 0.45 --seconds 6
PLAN_RUNS := $(foreach dof,1 2,$(foreach kind,rigid known unknown,$(foreach kg,$(TIP_PAYLOADS),$(PLANS)/$(dof)dof_$(kind)_$(kg)/timing.json)))

tip-demo: | $(READY)
	@$(MAKE) --no-print-directory --jobs 2 $(PLANS)/plans.html
	@echo
	@echo "open $(CURDIR)/$(PLANS)/plans.html"

$(PLANS)/inverse_%dof.json: build/bundle_%dof/observer.fmu
	$(call run,dropstitch plan $(TIP_PATH_$*) --plant build/plant.json --bundle $(<D) --out $@)

$(PLANS)/rigid_%dof.json: build/bundle_%dof/observer.fmu
	$(call run,dropstitch plan $(TIP_PATH_$*) --plant build/plant.json --bundle $(<D) --rigid --out $@)

plan_on_rig = $(call judge,dropstitch sil --bundle build/bundle_$(1)dof --rig --seed 5 --line virtual --plan $< --payload-kg $* $(2) --out $(@D))

$(PLANS)/1dof_rigid_%/timing.json: $(PLANS)/rigid_1dof.json
	$(call plan_on_rig,1,--payload-known)
$(PLANS)/2dof_rigid_%/timing.json: $(PLANS)/rigid_2dof.json
	$(call plan_on_rig,2,--payload-known)
$(PLANS)/1dof_known_%/timing.json: $(PLANS)/inverse_1dof.json
	$(call plan_on_rig,1,--payload-known)
$(PLANS)/2dof_known_%/timing.json: $(PLANS)/inverse_2dof.json
	$(call plan_on_rig,2,--payload-known)
$(PLANS)/1dof_unknown_%/timing.json: $(PLANS)/inverse_1dof.json
	$(call plan_on_rig,1,--runs 2)
$(PLANS)/2dof_unknown_%/timing.json: $(PLANS)/inverse_2dof.json
	$(call plan_on_rig,2,--runs 2)

$(PLANS)/plans.html: $(PLAN_RUNS)
	$(call run,dropstitch report plans $(@D) --out $@)

# --- link demo -----------------------------------------------------------------------------------

# The worked example of docs/plant/link.md: five commands, and the figures of its fit.
link-demo: build/link_demo/sil/timing.json

build/link_demo/link.toml: | $(READY)
	$(call run,dropstitch new $@ --length 0.6 --width 0.1 --rows 3 --servo XM430-W350 --mounting hanging --dof 1 --pressure-pa 20700 --largest-payload-kg 0.4)
build/link_demo/plant.json: build/link_demo/link.toml
	$(call run,dropstitch simulate --rig $< --out build/link_demo/trials --payloads 0 0.4 --seed 1)
	$(call run,dropstitch identify build/link_demo/trials --plant $< --out $@)
build/link_demo/bundle/manifest.json: build/link_demo/plant.json
	$(call run,dropstitch train build/link_demo/trials --dof 1 --plant $< --out $(@D))
build/link_demo/sil/timing.json: build/link_demo/bundle/manifest.json
	$(call judge,dropstitch sil --bundle $(<D) --rig build/link_demo/link.toml --line virtual --out $(@D))

# --- loop ----------------------------------------------------------------------------------------

# The bundle of the demo, or else one of a plant that is not identified: the timing is the same.
SIL_BUNDLE := build/$(if $(wildcard build/bundle_1dof/observer.fmu),,one_joint/)bundle_1dof

build/one_joint/trials/.done: | $(READY)
	$(call run,dropstitch simulate --out $(@D) --dof 1 --payloads 0 1 2 --seed $(SEED))
	@touch $@

build/one_joint/bundle_1dof/observer.fmu: build/one_joint/trials/.done
	$(call run,dropstitch train $(<D) --dof 1 --plant models/plant/nominal.toml --out $(@D))
	$(call run,dropstitch fmu build $(@D) --plant models/plant/nominal.toml --unit observer --out $@)

sil: $(SIL_BUNDLE)/observer.fmu
	$(call run,dropstitch sil --bundle $(<D) --line socket --seconds 10 --miss-rate 0.01 --out build/sil)

# 100,000 ticks under load with lost and damaged replies: 28 minutes.
soak: build/twin_2dof.fmu
	$(call run,dropstitch sil --bundle build/bundle_2dof --fmu $< --line socket --seconds 1700 \
	  --load 1 --faults lost=0.01 corrupt=0.01 --out build/soak)

faults: build/twin_2dof.fmu
	$(call judge,dropstitch faults --bundle build/bundle_2dof --fmu $< --out build/faults)

# What tests/hil/faults/test_recorded_runs.py asks of every change.
recorded-runs: $(COMPLETE)
	$(BIN)/python -m tests.hil.faults.recorded_runs --anew

# --- FMUs for other machines ---------------------------------------------------------------------

fmu-all: build/bundle_1dof/observer.fmu build/bundle_2dof/observer.fmu ssp
	@for unit in twin observer predictor; do for dof in 1 2; do for fmi in 2 3; do \
	  build="$(BIN)/dropstitch fmu build build/bundle_$${dof}dof --plant build/plant.json --unit $$unit --fmi $$fmi"; \
	  out=build/fmu_all/$${unit}_$${dof}dof_fmi$$fmi; \
	  $$build --platforms all --out $$out.fmu && $$build --platforms c-code --out $${out}_source.fmu || exit 2; \
	done; done; done

ssp: build/link_1dof.ssp build/link_2dof.ssp

build/link_%dof.ssp: build/bundle_%dof/observer.fmu
	$(call run,dropstitch fmu ssp $(<D) --plant build/plant.json --out $@)

# --- checks --------------------------------------------------------------------------------------

# Lint runs beside the tests; the output of each is printed when it ends.
test: $(COMPLETE)
	@$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint pytest PYTEST_OPTIONS='-m "not slow"'

test-all: $(COMPLETE)
	@$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint pytest

# worksteal gives each process one half of the tests in their order, so that most fixtures are
# built once; a process that has finished takes over tests of the other.
pytest: $(COMPLETE)
	$(BIN)/python -m pytest -n 2 --dist worksteal $(PYTEST_OPTIONS)

lint: $(COMPLETE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --cache-dir build/cache/lint-imports

# The same tests on the real servo at DROPSTITCH_HITL_PORT and on an emulated one.
hitl: $(COMPLETE)
	@test -n "$$DROPSTITCH_HITL_PORT" || \
	  { echo "set DROPSTITCH_HITL_PORT to the port of a real servo (docs/robot.md)"; exit 2; }
	$(BIN)/python -m pytest tests/hitl

hitl-emulated: $(COMPLETE)
	$(BIN)/python -m tests.hitl.emulated

fuzz: build/bundle_1dof/observer.fmu | $(COMPLETE)
	$(BIN)/python -m tests.fuzz --bundle $(<D) --keep

mutate: $(COMPLETE)
	$(BIN)/python -m tests.mutation $(if $(ONLY),--only $(ONLY)) $(if $(COUNT),--count $(COUNT)) --seed $(SEED)

fuzz-fmu: $(COMPLETE)
	$(BIN)/python -m tests.fmu.fuzz --seconds 600

# --- documents -----------------------------------------------------------------------------------

# The site of docs/; a warning is an error.
docs: $(COMPLETE)
	PYTHONPATH="$(CURDIR)" $(BIN)/python -m sphinx -b html -c docs/site -W --keep-going -q docs build/guides
	@echo
	@echo "open $(CURDIR)/build/guides/index.html"

# Parts of the figures; empty: all of them, and the page is written.
ONLY ?=

# One run of one commit, on an idle machine; begin with `make clean`.
figures: $(COMPLETE)
	@PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python -m bench.figures $(if $(ONLY),--only $(ONLY))

# --- packages ------------------------------------------------------------------------------------

# Wheels of the project and of the robot's packages; WHEELS names another platform and Python.
wheelhouse: $(READY)
	rm -rf dist/wheelhouse
	$(BIN)/python -m pip download --quiet --require-hashes --only-binary :all: --no-deps $(WHEELS) \
	  -r requirements/robot.txt -d dist/wheelhouse
	$(BIN)/python -m pip wheel --quiet --no-deps -w dist/wheelhouse .
	@ls dist/wheelhouse

LOCK = PATH="$$PATH:$(CURDIR)/$(BIN)" uv pip compile --quiet --universal --python-version 3.11 \
  --generate-hashes --no-emit-index-url --no-annotate --custom-compile-command "make lock"

lock:
	$(LOCK) pyproject.toml --fork-strategy fewest --extra record --extra trust --output-file requirements/robot.txt
	$(LOCK) pyproject.toml --extra test --group build --output-file requirements/test.txt
	$(LOCK) pyproject.toml --extra workshop --group build --constraint requirements/test.txt --output-file requirements/workshop.txt
	$(LOCK) --group setup --output-file requirements/uv.txt

clean:
	rm -rf build
