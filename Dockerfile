# An image of replan: kernels compiled, a user without rights, good for a read-only file system (docs/ci.md).
#
#   docker build -t replan .
#   docker run --rm --read-only --tmpfs /scratch -v "$PWD/my_logs:/logs:ro" -v "$PWD/results:/results" \
#       replan evaluate /logs --out /results/run

FROM python:3.11-slim AS built
COPY . /source
RUN python -m venv /opt/replan \
    && /opt/replan/bin/pip install --no-cache-dir --disable-pip-version-check -c /source/constraints.txt /source

FROM python:3.11-slim
COPY --from=built /opt/replan /opt/replan
# Kernels are for x86-64-v3 where the image is built on one that has it, and run on all that have (docs/ci.md).
ENV PATH=/opt/replan/bin:$PATH \
    NUMBA_CACHE_DIR=/opt/replan/kernels \
    PYTHONDONTWRITEBYTECODE=1 \
    TMPDIR=/scratch
RUN mkdir --mode=1777 /scratch && replan warmup --all && chmod -R a+rX,go-w /opt/replan \
    && useradd --create-home --uid 10001 replan && mkdir /results && chown replan /results \
    && rm -rf /scratch/*
USER replan
WORKDIR /home/replan
ENTRYPOINT ["replan"]
