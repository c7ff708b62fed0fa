# One word per task, the same locally and in CI.
#
# Everything is built once, in the release profile, and always for the whole workspace: with a part of it
# (`-p …`), Cargo would choose other features for shared dependencies and compile wgpu a second time.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CARGO_FLAGS := --release --workspace --locked
NEXTEST := $(shell cargo nextest --version >/dev/null 2>&1 && echo yes)
DENY := $(shell cargo deny --version >/dev/null 2>&1 && echo yes)

# Mesa's drivers ask for this folder and complain where it is missing (containers, cron).
ifndef XDG_RUNTIME_DIR
export XDG_RUNTIME_DIR := $(shell dir="$${TMPDIR:-/tmp}/evis-runtime-$$(id -u)"; \
	mkdir -p "$$dir" && chmod 700 "$$dir" && echo "$$dir")
endif

# The interpreter that the wheel is built with, for every Cargo call: another one would build pyo3 again.
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Without a device tests fail, as in CI; EVIS_REQUIRE_GPU=0 lets those that need one say that they did not run.
export EVIS_REQUIRE_GPU ?= 1

# What `make chart` measures, a file each; CHART_ARGS shapes it (see `evis chart --help`).
CHART_SCENES ?= spinner warehouse street desk
CHART_ARGS ?=

# What `make demo` simulates.
DEMO_SCENE ?= warehouse
DEMO_ARGS ?= --duration 0.25 --labels depth,flow,instance,hdr --label-rate 40

# What builds the site; the extra `docs` names the same.
SITE_PACKAGES := "mkdocs-material>=9.5,<10" "mkdocstrings[python]>=0.26" "latex2mathml>=3.77"

# What builds and checks the wheel for old systems.
PORTABLE_PACKAGES := "ziglang>=0.15" "auditwheel>=6.4"

# Seeds of the random scenes that `make check-long` tries.
LONG_SCENES ?= 12..324
# Seconds that `make check-long` and `make fuzz` read mutants of each kind of file.
FUZZ_S ?= 600

.PHONY: help setup demo test test-rust test-python test-readers test-torch test-mujoco test-ray check lint-rust lint-python check-long loom asan fuzz format bench bench-gpu bench-batch chart accuracy gallery real-recording wheel wheel-portable smoke docs site bless clean

help: ## List the tasks.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## Install what is missing: driver, linker, virtual environment.
	tools/setup "$(PYTHON)" "$(VENV)"

demo: wheel ## Simulate the warehouse; leaves a recording and pictures in out/.
	tools/install "$(BIN)" $$(command -v ffmpeg >/dev/null || echo video)
	mkdir -p out
	$(BIN)/evis run $(DEMO_SCENE) -o out/$(DEMO_SCENE).h5 $(DEMO_ARGS) --force --report out/$(DEMO_SCENE).json
	$(BIN)/evis preview out/$(DEMO_SCENE).h5 -o out/$(DEMO_SCENE).png
	$(BIN)/evis preview out/$(DEMO_SCENE).h5 -o out/$(DEMO_SCENE).mp4 \
	  || $(BIN)/evis preview out/$(DEMO_SCENE).h5 -o out/$(DEMO_SCENE).gif

test: test-rust test-python ## Every tier, Rust and Python.

test-rust: setup
ifeq ($(NEXTEST),yes)
	cargo nextest run $(CARGO_FLAGS)
	cargo test $(CARGO_FLAGS) --doc
else
	cargo test $(CARGO_FLAGS)
endif

test-python: wheel
	tools/install "$(BIN)" test docs
	$(BIN)/python -m pytest

test-readers: wheel ## Hold files and dense arrays of events against other programs'.
	tools/install "$(BIN)" test readers
	EVIS_READERS=1 $(BIN)/python -m pytest tests/test_readers.py tests/test_formats.py \
	  tests/test_representations.py

# Rust first, the wheel after it: maturin configures pyo3 in its own way, and each change of hands builds it again.
check: lint-rust ## Formatting, lints, types, stubs, and Rust's unit tests.
	cargo test $(CARGO_FLAGS) --lib --quiet
	$(MAKE) lint-python

lint-rust: setup ## Formatting and lints of Rust; licences and sources of what it depends on.
	cargo fmt --all --check
	cargo clippy $(CARGO_FLAGS) --all-targets -- -D warnings
ifeq ($(DENY),yes)
	cargo deny --locked check bans licenses sources
else
	@echo "cargo-deny is not installed: licences and sources of the dependencies are not checked"
	@test -z "$$EVIS_REQUIRE_DENY"
endif

lint-python: wheel ## Formatting, lints and types of Python, and the stubs against the binary.
	tools/install "$(BIN)" test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest evis._evis --mypy-config-file pyproject.toml

test-torch: wheel ## Hold data sets and keyframes against PyTorch, which it installs (the CPU's build where pip finds one).
	tools/install "$(BIN)" test torch
	$(BIN)/python -m pytest tests/test_torch.py tests/test_torch_keyframes.py tests/test_dataset.py tests/test_site.py \
	  tests/test_isaaclab.py tests/test_gbuffer.py

# With an environment of its own: the oldest release needs NumPy 1.
test-mujoco: wheel ## Hold evis.mujoco against the oldest MuJoCo that it takes (Python 3.10 to 3.12).
	"$(PYTHON)" -m venv target/mujoco-oldest
	tools/install target/mujoco-oldest/bin
	target/mujoco-oldest/bin/python -m pip install --quiet "mujoco==3.1.1" "numpy<2" "pytest>=8"
	target/mujoco-oldest/bin/python -m pytest tests/test_mujoco.py

test-ray: wheel ## Kill a worker of a Ray cluster, which it starts, while it simulates a data set.
	tools/install "$(BIN)" test ray
	$(BIN)/python -m pytest tests/test_dataset.py

check-long: setup ## What takes long: hundreds of random scenes, mutants of files for FUZZ_S seconds per kind, loom, asan.
	EVIS_SCENES=$(LONG_SCENES) cargo test $(CARGO_FLAGS) --lib -- random_scenes --nocapture
	EVIS_LONG=1 cargo test $(CARGO_FLAGS) --test lens -- --nocapture
	EVIS_FUZZ_S=$(FUZZ_S) cargo test $(CARGO_FLAGS) --test mutated_files -- mutated_ --nocapture
	$(MAKE) loom asan

loom: ## Try the threads that share a push in every order of their atomic operations.
	cargo test --manifest-path loom/Cargo.toml

# The stable compiler has the sanitizer, but calls it unstable. With a target folder of its own, since every crate is
# built for it. wgpu is not among what evis-core depends on, so that choosing one package costs nothing here.
ASAN := RUSTC_BOOTSTRAP=1 RUSTFLAGS="-Zsanitizer=address" CARGO_TARGET_DIR=target/asan cargo test --release --locked \
	-p evis-core --target "$$(rustc -vV | sed -n 's/^host: //p')"

asan: ## The tests of evis-core with AddressSanitizer: an access to memory that is not there ends them.
	seen=$$($(ASAN) --test address_sanitizer -- --ignored 2>&1 || true); \
	  grep -q heap-buffer-overflow <<< "$$seen" || { echo "$$seen"; echo "AddressSanitizer is not in force"; exit 1; }
	$(ASAN) --tests

fuzz: ## Look for files that break a reader, with cargo-fuzz, FUZZ_S seconds per kind; the corpus stays in fuzz/corpus/.
	broken=; for target in $$(cd fuzz/fuzz_targets && ls *.rs | sed 's/\.rs$$//'); do \
	  mkdir -p fuzz/corpus/$$target; \
	  cargo fuzz run --sanitizer none $$target -- -max_total_time=$(FUZZ_S) -rss_limit_mb=1024 -timeout=60 \
	    -print_final_stats=1 || broken="$$broken $$target"; \
	done; \
	test -z "$$broken" || { echo "broken:$$broken; fuzz/artifacts has the files"; exit 1; }

format: ## Format Rust and Python in place.
	cargo fmt --all
	$(BIN)/ruff format .

bench: setup ## Speed, as ratios on this machine.
	cargo bench --profile release --workspace --locked --bench native --bench splat --bench emulator --bench codecs \
	  --bench representations
	if [ -f benches/bench.py ]; then \
	  $(MAKE) wheel && tools/install "$(BIN)" test && $(BIN)/python benches/bench.py \
	  && $(BIN)/python benches/representations.py && $(BIN)/python benches/formats.py \
	  && $(BIN)/python benches/closed_loop.py && $(BIN)/python benches/dataset.py; fi

bench-batch: setup ## Cost per camera with 1 to 256 cameras, on this machine's adapter; minutes on a software driver.
	cargo bench --profile release --workspace --locked --bench batch

bench-gpu: setup ## Cost of each method with many cameras on this machine's adapter; tables in out/.
	cargo bench --profile release --workspace --locked --bench gpu -- out="$(CURDIR)/out"

chart: wheel ## Measure speed against accuracy on the built-in scenes, in out/chart; redraw docs/images/presets.svg.
	tools/install "$(BIN)" plot
	mkdir -p out/chart
	for scene in $(CHART_SCENES); do \
	  $(BIN)/evis chart "$$scene" $(CHART_ARGS) --report "out/chart/$$scene.json" -o "out/chart/$$scene.png"; \
	done
	$(BIN)/evis chart $(CHART_SCENES:%=--from out/chart/%.json) -o out/chart/all.svg
	$(BIN)/python tools/presets_chart.py

accuracy: wheel ## Measure what limits accuracy; refills the tables of docs/accuracy.md.
	tools/install "$(BIN)"
	$(BIN)/python tools/accuracy.py $(BIN)/evis

gallery: wheel ## Draw the pictures of docs/gallery.md.
	tools/install "$(BIN)" plot view
	$(BIN)/python tools/gallery.py

real-recording: wheel ## Set a real recording from EVIS_ASSETS beside a simulation; refills docs/real-recording.md.
	tools/install "$(BIN)" plot
	$(BIN)/python -c 'import PIL' 2>/dev/null || $(BIN)/python -m pip install --quiet pillow
	$(BIN)/python tools/real_recording.py "$(EVIS_ASSETS)"

wheel: setup ## Build the abi3 wheel into dist/.
	rm -f dist/evis-*.whl
	$(BIN)/maturin build --release --locked --out dist --interpreter "$(PYO3_PYTHON)"

# Linked by Zig against glibc 2.28, so that it loads on RHEL 8 and what came after it. With a target folder of its
# own: another linker would build everything anew at each change between the two.
wheel-portable: setup ## Build the manylinux_2_28 wheel into dist/portable/ and check the symbols that it asks for.
	$(BIN)/python -m pip install --quiet $(PORTABLE_PACKAGES)
	rm -rf dist/portable
	PATH="$(CURDIR)/$(BIN):$$PATH" CARGO_TARGET_DIR=target/portable $(BIN)/maturin build --release --locked --zig \
	  --target "$$(uname -m)-unknown-linux-gnu" --compatibility manylinux_2_28 --out dist/portable \
	  --interpreter "$(PYO3_PYTHON)"
	$(BIN)/auditwheel show dist/portable/evis-*.whl
	$(BIN)/python tools/portable.py dist/portable/evis-*.whl

smoke: wheel ## Install the wheel into a clean environment and stream events from it.
	tools/smoke "$(PYTHON)" dist/evis-*.whl

docs: setup site ## Rust documentation in target/doc and the site in out/site, warnings are errors.
	RUSTDOCFLAGS="-D warnings" cargo doc --release --workspace --locked --no-deps

# Reads docstrings from the sources, so that it needs no wheel.
site: setup ## The docs site in out/site; nothing is fetched when it is viewed.
	$(BIN)/python -m pip install --quiet $(SITE_PACKAGES)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

bless: wheel ## Accept the snapshots that the tests see now.
	tools/install "$(BIN)" test
	EVIS_BLESS=1 cargo test $(CARGO_FLAGS)
	EVIS_BLESS=1 $(BIN)/python -m pytest

clean: ## Remove everything that was built.
	cargo clean
	rm -rf $(VENV) dist out
