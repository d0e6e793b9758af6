# Scheduler, workers and the command from one image, so that their versions agree.
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libgl1 libopengl0 libgomp1 && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir '/source[svg,heic]' /source/plugins/mlens-dask && rm -rf /source
# whoever writes the lenses runs the containers, and may write what is compiled
ENV HOME=/home/lens
RUN mkdir $HOME && mlens doctor --warm && chmod -R a+rwX $HOME
WORKDIR /lenses
