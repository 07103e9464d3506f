# docker build -t facetrack . && docker run --rm -v "$PWD:/clips" facetrack run clip.mp4
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir '/src[plot,detect,people]'
WORKDIR /clips
ENTRYPOINT ["facetrack"]
