# A gateway without NATS and console, as bench/router.exs starts it in an OS process of its own:
#
#     mix run --no-compile bench/support/router_node.exs CLIENT_URL LINK_URL [LINK_URL ...]
#
# Says "ready" when it listens; ends with its standard input.

[client | links] = System.argv()
gateway = :bench

config =
  Aerie.Config.default([
    {"mavlink.local_addr", "off"},
    {"mavlink.system_id", 245},
    # What vehicles hear of each other is not what is measured.
    {"router.between_vehicles", "none"},
    {"clients", []},
    {"limits.max_links", 200},
    {"limits.max_vehicles", String.to_integer(System.get_env("ROUTER_BENCH_VEHICLES", "250"))},
    {"limits.max_peers", 256}
  ])

measured = [
  Aerie.Base.Store,
  Aerie.Base.PubSub,
  MavRouter.Router.Supervisor,
  Aerie.Vehicle.Supervisor,
  MavRouter.Link.Supervisor
]

for {module, options} <- Aerie.Gateway.parts(gateway, config),
    module in measured,
    do: {:ok, _pid} = module.start_link([gateway: gateway] ++ options)

for url <- links, do: {:ok, _id} = MavRouter.Link.start(gateway, url)
{:ok, _id} = MavRouter.Client.add(gateway, client)
IO.puts("ready")
IO.read(:stdio, :line)
