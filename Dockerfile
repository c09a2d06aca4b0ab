# The shipped policy in MuJoCo, without PyTorch: docker build -t renet . && docker run --rm renet
FROM python:3.12-slim
WORKDIR /renet
COPY pyproject.toml README.md LICENSE NOTICE requirements-lock.txt ./
COPY src src
RUN pip install --no-cache-dir -c requirements-lock.txt '.[sim]'
RUN useradd --create-home renet && mkdir /results && chown renet /results
USER renet
# A folder of yours to mount: docker run --rm --user "$(id -u)" -v "$PWD/results:/results" renet
WORKDIR /results
CMD ["renet", "deploy", "--robot", "mujoco", "--camera", "sim", "--terrain", "gap", "--level", "6", "--fault", "unplugged@3.2s", "--seconds", "10", "--out", "/results/deploy"]
