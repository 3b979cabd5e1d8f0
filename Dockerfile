# SPDX-License-Identifier: BSD-3-Clause
# coman and its nodes on an installed ROS 2 Jazzy:
#   docker build -t coman . && docker run --rm -it --network host coman ros2 launch coman_reduced_model predict.launch.py
FROM ros:jazzy

ENV PIP_BREAK_SYSTEM_PACKAGES=1
WORKDIR /workspace/src/coman_reduced_model
COPY . .
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths . msg_defs --ignore-src --rosdistro jazzy -y \
    && pip install --no-cache-dir --ignore-installed "typer>=0.12.5" rich \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /workspace
RUN . /opt/ros/jazzy/setup.sh \
    && colcon build --base-paths src/coman_reduced_model src/coman_reduced_model/msg_defs \
    && . install/setup.sh \
    && python3 -m coman_reduced_model.warm_up
# The entry point of the base image sources its ROS; a shell that it starts finds this workspace as well.
RUN sed -i 's|^exec|source /workspace/install/setup.bash\nexec|' /ros_entrypoint.sh
CMD ["bash"]
