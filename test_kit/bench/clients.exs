# Measures the cost of a client by WebSocket, mavlink.sock and TCP, with one source of frames by UDP and one or five
# clients. The gateway is this program, without sessions, on one scheduler if it is started so (ELIXIR_ERL_OPTIONS="+S
# 1:1"); the source and the clients are another program.
#
#     bin/bench clients [--seconds 3]
#
# Columns: the highest frames/s that arrived at every client without loss for that many seconds; p50 and p99 of the
# added latency at 1,000 and 10,000 frames/s, in microseconds (including the source's send and the client's receive);
# CPU seconds of the gateway per 100,000 received frames, at 10,000 frames/s; memory of the gateway for each further
# client.

Code.require_file("harness.exs", __DIR__)

defmodule ClientsBench do
  alias Aerie.Base.{Names, PubSub, Store}
  alias Bench.{Gateway, OSProcess, Sample, Table}

  @rates [5_000, 10_000, 20_000, 30_000, 40_000, 50_000, 60_000, 80_000]
  @parts [
    Store,
    PubSub,
    MavRouter.Router.Supervisor,
    MavRouter.Link.Supervisor,
    Aerie.Fleet.Client.Supervisor
  ]
  @widths [14, 9, 19, 18, 18, 15, 10]

  def main(dir, seconds) do
    load = OSProcess.vm("client_load.exs")
    {source, ways} = gateway(dir)
    figures = ["p50/p99 at 1,000", "at 10,000", "CPU s/100,000", "KiB/client"]
    Table.columns(["", "clients", "frames/s, no loss" | figures], @widths)
    for {name, way} <- ways, clients <- [1, 5], do: table(name, way, source, load, clients, seconds)
    :peer.stop(load)
  end

  defp gateway(dir) do
    gateway = make_ref()
    clients = for part <- ~w(sockets websocket), do: {"#{part}.max_clients", 200}
    config = Gateway.config(dir, [{"sockets.dir", dir}, {"http.port", 0}, {"websocket.port", 0} | clients])
    Gateway.parts(gateway, config, @parts)

    {:ok, _server} =
      Aerie.Api.Endpoint.start_link(gateway: gateway, settings: Aerie.Api.Settings.from(config))

    # A session that wants nothing.
    spawn_link(fn ->
      :ok = Names.register(gateway, :session, {"main", 1})
      Enum.each(Stream.cycle([:again]), fn _again -> receive(do: (_frames -> :ok)) end)
    end)

    ways = [
      {"WebSocket", {:websocket, Aerie.Api.WebSocket.port(gateway)}},
      {"mavlink.sock", {:unix, Path.join(dir, "mavlink.sock")}},
      {"TCP", {:tcp, Gateway.client(gateway, "tcpin:127.0.0.1:0")}}
    ]

    {Gateway.link(gateway, "udpin:127.0.0.1:0", id: "source"), ways}
  end

  defp table(name, way, source, load, clients, seconds) do
    run = fn rate ->
      :peer.call(load, Bench.ClientLoad, :run, [source, way, clients, rate, seconds], 120_000)
    end

    {_sent, _got, slow} = run.(1_000)
    before = Sample.cpu()
    {sent, _got, fast} = run.(10_000)
    used = (Sample.cpu() - before) / sent * 100_000
    best = @rates |> Enum.take_while(&match?({n, n, _times}, run.(&1))) |> List.last("< #{hd(@rates)}")
    memory = if clients == 1, do: memory(way, load), else: ""
    Table.columns([name, clients, best, both(slow), both(fast), Float.round(used, 2), memory], @widths)
  end

  defp both([]), do: "nothing came"
  defp both(times), do: Sample.spread(times, [0.5, 0.99])

  defp memory(way, load) do
    before = settled()
    pids = for _ <- 1..100, do: :peer.call(load, :erlang, :spawn, [Bench.ClientLoad, :client, [way, self()]])
    Process.sleep(2_000)
    more = settled() - before
    for pid <- pids, do: :peer.call(load, :erlang, :exit, [pid, :kill])
    Process.sleep(500)
    div(more, 100 * 1024)
  end

  defp settled do
    Enum.each(Process.list(), &:erlang.garbage_collect/1)
    :erlang.memory(:total)
  end
end

options = Bench.Options.read(__ENV__.file, seconds: 3)
Bench.Gateway.in_folder("clients", &ClientsBench.main(&1, options[:seconds]))
