# Measures the cost of a client by WebSocket, mavlink.sock and TCP, with one source of frames by UDP and one or five clients.
# The gateway is this program, without sessions, on one scheduler; the source and the clients are another program.
#
#     elixir --erl "+S 1:1" -S mix run bench/clients.exs [--seconds 3]          or  bin/bench clients
#
# Columns: the highest frames/s that arrived at every client without loss for that many seconds; p50 and p99 of the added
# latency at 1,000 and 10,000 frames/s, in microseconds (including the source's send and the client's receive); CPU seconds
# of the gateway per 100,000 received frames, at 10,000 frames/s; memory of the gateway for each further client.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

{:module, _name, load_binary, _last} =
  defmodule ClientsBench.Load do
    # Runs in the other program. A frame is of one length, and has the time of its sending in it.
    @size 28

    def frame(now) do
      MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: now, roll: 0.5, yaw: 1.0},
        system: 1,
        component: 1,
        seq: 0
      )
    end

    # Everything of a run: sent, the fewest that a client got, and the sorted latencies.
    def run(source, way, clients, rate, seconds) do
      parent = self()
      pids = for _ <- 1..clients, do: spawn_link(fn -> client(way, parent) end)
      for pid <- pids, do: receive(do: ({:open, ^pid} -> :ok))
      # The gateway is to know them first, which the first frame shows.
      {:ok, socket} = :gen_udp.open(0, [:binary, active: false])
      sent = send_all(socket, source, rate, seconds)
      results = for pid <- pids, do: result(pid)
      :gen_udp.close(socket)
      {sent, results |> Enum.map(&length/1) |> Enum.min(), results |> Enum.concat() |> Enum.sort()}
    end

    defp result(pid) do
      send(pid, :result)
      receive(do: ({:result, ^pid, times} -> times))
    end

    # A burst each millisecond.
    defp send_all(socket, port, rate, seconds) do
      start = System.monotonic_time(:microsecond)

      Enum.reduce(1..(seconds * 1000), 0, fn ms, sent ->
        due = div(rate * ms, 1000)
        wait(start + ms * 1000)
        for _ <- (sent + 1)..due//1, do: :gen_udp.send(socket, {127, 0, 0, 1}, port, frame(clock()))
        due
      end)
    end

    defp wait(until) do
      left = until - System.monotonic_time(:microsecond)
      if left > 0, do: Process.sleep(div(left + 999, 1000))
    end

    defp clock, do: Bitwise.band(System.os_time(:microsecond), 0xFFFFFFFF)

    def client(way, parent) do
      {socket, prefix} = open(way)
      send(parent, {:open, self()})
      loop(socket, prefix, "", [], parent)
    end

    defp open({:tcp, port}) do
      {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, options())
      {socket, 0}
    end

    defp open({:unix, path}) do
      {:ok, socket} = :gen_tcp.connect({:local, path}, 0, options())
      {socket, 4}
    end

    defp open({:websocket, port}) do
      {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, options(false))

      :ok =
        :gen_tcp.send(socket, [
          "GET / HTTP/1.1\r\nhost: 127.0.0.1:#{port}\r\nupgrade: websocket\r\nconnection: Upgrade\r\n",
          "sec-websocket-version: 13\r\nsec-websocket-key: #{Base.encode64(:crypto.strong_rand_bytes(16))}\r\n\r\n"
        ])

      {:ok, "HTTP/1.1 101" <> _rest} = :gen_tcp.recv(socket, 0, 10_000)
      :inet.setopts(socket, active: true)
      {socket, 2}
    end

    defp options(active \\ true),
      do: [:binary, active: active, nodelay: true, buffer: 65_536, recbuf: 1_048_576]

    defp loop(socket, prefix, rest, times, parent) do
      receive do
        {:tcp, ^socket, bytes} ->
          {times, rest} = take(rest <> bytes, prefix, clock(), times)
          loop(socket, prefix, rest, times, parent)

        :result ->
          settle(socket, prefix, rest, times, parent)
      end
    end

    # What was sent last is still on its way.
    defp settle(socket, prefix, rest, times, parent) do
      receive do
        {:tcp, ^socket, bytes} ->
          {times, rest} = take(rest <> bytes, prefix, clock(), times)
          settle(socket, prefix, rest, times, parent)
      after
        500 ->
          :gen_tcp.close(socket)
          send(parent, {:result, self(), times})
      end
    end

    defp take(bytes, prefix, now, times) do
      case bytes do
        # A frame of another length is the gateway's own heartbeat or a ping: neither is sent in this benchmark.
        <<_::binary-size(^prefix), _::10-binary, at::32-little, _::binary-size(@size - 14), rest::binary>> ->
          take(rest, prefix, now, [Bitwise.band(now - at, 0xFFFFFFFF) | times])

        rest ->
          {times, rest}
      end
    end
  end

defmodule ClientsBench do
  alias Aerie.Base.Names
  alias ClientsBench.Load

  @rates [5_000, 10_000, 20_000, 30_000, 40_000, 50_000, 60_000, 80_000]

  def main(argv, load_binary) do
    seconds = MavCodec.Bench.Options.read(__ENV__.file, argv, seconds: 3)[:seconds]
    dir = Path.join(System.tmp_dir!(), "clients-bench-#{System.pid()}")
    File.mkdir_p!(dir)
    {:ok, load, _node} = :peer.start_link(%{connection: :standard_io, args: paths()})

    {:module, Load} = :peer.call(load, :code, :load_binary, [Load, ~c"clients.exs", load_binary])

    try do
      {source, ways} = gateway(dir)

      IO.puts(
        row([
          "",
          "clients",
          "frames/s, no loss",
          "p50/p99 at 1,000",
          "at 10,000",
          "CPU s/100,000",
          "KiB/client"
        ])
      )

      for {name, way} <- ways, clients <- [1, 5], do: table(name, way, source, load, clients, seconds)
    after
      :peer.stop(load)
      File.rm_rf!(dir)
    end
  end

  defp paths, do: Enum.flat_map(:code.get_path(), &[~c"-pa", &1])

  defp gateway(dir) do
    gateway = make_ref()

    config =
      Aerie.Config.default([
        {"mavlink.local_addr", "off"},
        {"clients", []},
        {"http.port", 0},
        {"sockets.dir", dir},
        {"sockets.max_clients", 200},
        {"websocket.port", 0},
        {"websocket.max_clients", 200}
      ])

    measured =
      [Aerie.Base.Store, Aerie.Base.PubSub, MavRouter.Router.Supervisor, MavRouter.Link.Supervisor] ++
        [Aerie.Fleet.Client.Supervisor]

    for {module, options} <- Aerie.Gateway.parts(gateway, config),
        module in measured,
        do: {:ok, _pid} = module.start_link([gateway: gateway] ++ options)

    {:ok, _server} = FleetWeb.Endpoint.start_link(gateway: gateway, settings: FleetWeb.Settings.from(config))

    # A session that wants nothing.
    spawn_link(fn ->
      :ok = Names.register(gateway, :session, {"main", 1})
      discard()
    end)

    {:ok, link} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "source")
    {:ok, tcp} = MavRouter.Client.add(gateway, "tcpin:127.0.0.1:0")
    port = Enum.find(MavRouter.Client.endpoints(gateway), &(&1.id == tcp)).port

    ways = [
      {"WebSocket", {:websocket, FleetWeb.WebSocket.port(gateway)}},
      {"mavlink.sock", {:unix, Path.join(dir, "mavlink.sock")}},
      {"TCP", {:tcp, port}}
    ]

    true = is_pid(Names.whereis(gateway, :link, link))
    {MavRouter.Link.snapshot(gateway, link).port, ways}
  end

  defp discard, do: receive(do: (_frames -> discard()))

  defp table(name, way, source, load, clients, seconds) do
    run = fn rate -> :peer.call(load, Load, :run, [source, way, clients, rate, seconds], 120_000) end
    {_sent, _got, slow} = run.(1_000)
    before = cpu()
    {sent, _got, fast} = run.(10_000)
    used = (cpu() - before) / sent * 100_000
    best = Enum.reduce_while(@rates, 0, &ladder(run, &1, &2))

    [
      name,
      "#{clients}",
      if(best == 0, do: "< #{hd(@rates)}", else: "#{best}"),
      both(slow),
      both(fast),
      "#{Float.round(used, 2)}",
      if(clients == 1, do: "#{memory(way, load)}", else: "")
    ]
    |> row()
    |> IO.puts()
  end

  defp ladder(run, rate, best) do
    {sent, got, _times} = run.(rate)
    if got == sent, do: {:cont, rate}, else: {:halt, best}
  end

  defp both([]), do: "nothing came"
  defp both(times), do: "#{share(times, 0.5)} / #{share(times, 0.99)}"
  defp share(times, share), do: Enum.at(times, trunc(length(times) * share))

  # In seconds, of all threads of this program.
  defp cpu, do: elem(:erlang.statistics(:runtime), 0) / 1000

  defp memory(way, load) do
    before = settled()
    pids = for _ <- 1..100, do: :peer.call(load, :erlang, :spawn, [Load, :client, [way, self()]])
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

  defp row(cells) do
    widths = [14, 9, 19, 18, 18, 15, 10]
    Enum.zip_with(cells, widths, &String.pad_trailing/2) |> Enum.join() |> String.trim_trailing()
  end
end

ClientsBench.main(System.argv(), load_binary)
