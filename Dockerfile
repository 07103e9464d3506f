# docker build -t facetrack . && docker run --rm -v "$PWD:/clips" --user "$(id -u)" facetrack run clip.mp4
FROM python:3.12-slim@sha256:78387bc3881b8273120a12ebe6c1ab22b018ccc2c9adf565ae1ac9b536e184ea
COPY . /src
RUN pip install --no-cache-dir --require-hashes -r /src/.ci/container.txt \
    && pip install --no-cache-dir --no-deps --no-build-isolation /src && rm -r /src \
    && useradd --create-home --uid 10001 facetrack
USER 10001
ENV NUMBA_CACHE_DIR=/tmp/facetrack-kernels
WORKDIR /clips
ENTRYPOINT ["facetrack"]
