"""Serve by LeRobot's own `policy_server`, at a port of its choice, in LeRobot's environment."""

from __future__ import annotations

from concurrent import futures

from vlagents.policies.torch_stack import import_stack

_, grpc, server, configs, grpc_services = import_stack(
    "lerobot",
    "grpc",
    "lerobot.async_inference.policy_server",
    "lerobot.async_inference.configs",
    "lerobot.transport.services_pb2_grpc",
)

serving = grpc.server(futures.ThreadPoolExecutor(4))
policy_server = server.PolicyServer(configs.PolicyServerConfig(inference_latency=0.0))
grpc_services.add_AsyncInferenceServicer_to_server(policy_server, serving)
port = serving.add_insecure_port("127.0.0.1:0")
serving.start()
print(f"Serving lerobot at lerobot+grpc://127.0.0.1:{port}. ", flush=True)
serving.wait_for_termination()
