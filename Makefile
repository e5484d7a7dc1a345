# Habit's door to ./dev, which needs no make.
.PHONY: evaluate test bench docs clean
evaluate test bench docs:
	@./dev $@
clean:
	rm -rf .venv build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name '*.nb[ci]' -not -path './.venv/*' -delete
