# docker build -t tacgen . && docker run --rm -v "$PWD":/data tacgen run quickstart -o /data/out/quickstart
FROM python:3.12-slim
# compiled code and traced light are kept in the cache: mount a volume at /cache to keep them between containers
ENV OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 HOME=/tmp XDG_CACHE_HOME=/cache
COPY . /src
RUN pip install --no-cache-dir /src && rm -rf /src && mkdir -p /cache && chmod 1777 /cache
WORKDIR /data
ENTRYPOINT ["tacgen"]
CMD ["--help"]
