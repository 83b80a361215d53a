# What a vehicle runs, from the wheel and with its libraries alone: no torch, scipy or sympy. The target `web` has the page
# besides, `rig` simulates a vehicle, and `broker` is an MQTT broker for trials.
# Another base, as one that was imported where there is no registry: --build-arg BASE=...
ARG BASE=python:3.12-slim
FROM ${BASE} AS wheel
COPY . /source
RUN python3 -m venv /build && /build/bin/pip wheel --quiet --no-deps --wheel-dir /wheel /source

FROM ${BASE} AS vehicle
COPY --from=wheel /wheel /wheel
COPY constraints.txt /wheel/
RUN python3 -m venv --copies /opt/faultline \
    && /opt/faultline/bin/pip install --quiet --no-cache-dir --constraint /wheel/constraints.txt /wheel/*.whl \
    && mkdir -p /run/faultline /var/lib/faultline-bundles /var/lib/faultline-mqtt \
    && chown 65534:65534 /run/faultline /var/lib/faultline-mqtt
ENV PATH=/opt/faultline/bin:$PATH PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
USER 65534:65534
ENTRYPOINT ["/opt/faultline/bin/python", "-P", "/opt/faultline/bin/faultline"]
CMD ["--help"]

FROM vehicle AS web
USER 0:0
RUN /opt/faultline/bin/pip install --quiet --no-cache-dir --constraint /wheel/constraints.txt "$(echo /wheel/*.whl)[web]"
USER 65534:65534

FROM ${BASE} AS broker
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends mosquitto
USER 65534:65534
ENTRYPOINT ["/usr/sbin/mosquitto"]

FROM vehicle AS rig
USER 0:0
RUN /opt/faultline/bin/pip install --quiet --no-cache-dir --constraint /wheel/constraints.txt rich
USER 65534:65534
