# docker build -t lidar-emu .     then: docker run --rm lidar-emu run descent.yaml
# Untested: no Docker was at hand.
FROM python:3.12-slim AS wheel
RUN apt-get update && apt-get install -y --no-install-recommends gcc g++ libc6-dev make
COPY . /source
WORKDIR /source
RUN pip install --no-cache-dir build hatchling . \
 && python tools/build_kernels.py build/kernels \
 && LIDAR_EMU_KERNELS=build/kernels python -m build --wheel --no-isolation --outdir dist

FROM python:3.12-slim
COPY --from=wheel /source/dist /wheels
RUN wheel=$(ls /wheels/*.whl) && pip install --no-cache-dir "$wheel[geo,pandas,plots,tables]" && rm -r /wheels \
 && useradd --create-home lidar
USER lidar
WORKDIR /home/lidar
ENTRYPOINT ["lidar-emu"]
