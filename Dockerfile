# docker build -t shapefit . && docker run --rm -v "$PWD/pages:/shapefit/results" shapefit
# runs the demo; its pages are then in the folder pages/demo. Any other command works as well:
# docker run --rm -v "$PWD:/data" -w /data shapefit shapefit fit keypoints -d people -o walk.trc
FROM python:3.11-slim

RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /shapefit
COPY . .
# Kernels for every processor, since the image may run on another than it is built on.
RUN SHAPEFIT_LEVELS=all make .venv/runs
ENV PATH="/shapefit/.venv/bin:$PATH"
CMD ["make", "demo"]
