# docker build -t shapefit .
# docker run --rm --user "$(id -u)" -v "$PWD:/data" shapefit demo
# runs the demo, whose page is then in shapefit-demo. Any other command works as well:
# docker run --rm --user "$(id -u)" -v "$PWD:/data" shapefit fit keypoints -o walk.trc
FROM python:3.12-slim AS build
RUN apt-get update && apt-get install --yes --no-install-recommends g++
WORKDIR /source
COPY . .
# Kernels for every processor, since the image may run on another than it is built on.
RUN SHAPEFIT_LEVELS=all python -m pip wheel --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
RUN --mount=from=build,source=/wheels,target=/wheels \
    python -m pip install --no-cache-dir "$(echo /wheels/*.whl)[plots]" \
    && useradd --create-home shapefit
USER shapefit
WORKDIR /data
ENTRYPOINT ["shapefit"]
CMD ["--help"]
