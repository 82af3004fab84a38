# A gateway without NATS and console, as bench/router.exs starts it in an OS process of its own:
#
#     mix run --no-compile bench/support/router_node.exs CLIENT_URL LINK_URL [LINK_URL ...]
#
# Says "ready" when it listens; ends with its standard input.

[client | links] = System.argv()
gateway = :bench

config = %{
  mavlink: %{system_id: 245, component_id: 191, dialects: [:all], sysid32: false},
  # What vehicles hear of each other is not what is measured.
  router: %{between_vehicles: :none},
  limits: %{
    max_links: 200,
    max_vehicles: String.to_integer(System.get_env("ROUTER_BENCH_VEHICLES", "250")),
    max_peers: 256
  }
}

for module <- [
      Aerie.Store,
      Aerie.Store.PubSub,
      Aerie.Router.Supervisor,
      Aerie.Vehicle.Supervisor,
      Aerie.Link.Supervisor
    ] do
  {:ok, _pid} = module.start_link([gateway: gateway, config: config] ++ Aerie.Gateway.plugs(config))
end

for url <- links, do: {:ok, _id} = Aerie.Link.start(gateway, url)
{:ok, _id} = Aerie.Link.Clients.add(gateway, client)
IO.puts("ready")
IO.read(:stdio, :line)
