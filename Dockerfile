# Both commands of README.md in a container:
#     docker build --tag neoworld_mjx . && docker run --rm neoworld_mjx
FROM python:3.11-slim
# Tests list the files of the repository, and look at pages in a browser.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends git chromium \
    && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir uv
WORKDIR /workspace
COPY . .
# The build may belong to another user than the one who cloned.
RUN git config --system --add safe.directory '*'
RUN uv sync --extra dev
CMD ["bash", "-ec", "uv run neoworld reconstruct examples/coffee.png --out out --json && uv run --extra dev pytest -n 2 --dist loadfile"]
