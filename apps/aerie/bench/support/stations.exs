defmodule StationsBench do
  @moduledoc """
  Ground stations that ask for all parameters of a simulated ArduPilot, at once or each after the one before has them, through a gateway
  that knows none of them yet: what the vehicle had to send for it (PARAM_VALUE and MAVLink FTP, counted on its wire), and how long it took
  until the last station had them all. All that ask at once hear one list even without `served`, because the vehicle sends it to everybody.
  """

  alias Aerie.Base.Store
  alias MavRouter.{Client, Link}
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @parts [
           Store,
           Aerie.Base.PubSub,
           Aerie.Control.Policy.Supervisor,
           MavRouter.Router.Supervisor,
           Aerie.Vehicle.Supervisor
         ] ++
           [MavRouter.Link.Supervisor, Aerie.Control.Params.CacheWriter, Aerie.Control.ReadCache.Supervisor]
  @counted [M.ParamValue.id(), M.FileTransferProtocol.id()]
  # What ground stations wait until they ask for what is missing.
  @silence_ms 1_000

  def main(dir) do
    IO.puts("\nstations     they ask   served   frames of the vehicle   ms until the last one has all")

    for order <- [:at_once, :in_turn], served? <- [true, false], n <- [1, 5, 20] do
      {frames, ms} = run(Path.join(dir, "stations-#{n}-#{order}-#{served?}"), n, order, served?)

      cells = [{n, 8}, {String.replace("#{order}", "_", " "), 13}, {if(served?, do: "on", else: "off"), 9}]

      IO.puts(
        Enum.map_join(cells ++ [{frames, 24}, {ms, 32}], fn {cell, width} ->
          String.pad_leading("#{cell}", width)
        end)
      )
    end
  end

  defp run(dir, n, order, served?) do
    gateway = make_ref()

    config =
      Aerie.Config.default([
        {"mavlink.local_addr", "off"},
        {"clients", []},
        {"params.dir", Path.join(dir, "params")},
        {"policy.audit.dir", Path.join(dir, "audit")}
      ])

    parts =
      for {module, options} <- Aerie.Gateway.parts(gateway, config), module in @parts do
        {:ok, pid} = module.start_link([gateway: gateway] ++ options)
        pid
      end

    {:ok, link} = Link.start(gateway, "udpin:127.0.0.1:0", network: "main")
    port = until(fn -> Store.link(gateway, link)[:port] end)
    {wire, wire_port} = wire(port)

    {:ok, sim} =
      SimVehicle.start_link(firmware: :ardupilot, link: "udpout:127.0.0.1:#{wire_port}", ready_s: 0.5)

    known? = &match?(%{capabilities: bits, clock: %{rtt_us: us}} when is_integer(bits) and is_integer(us), &1)
    until(fn -> known?.(Store.vehicle(gateway, {"main", 1})) end)
    {:ok, "gcs"} = Client.add(gateway, %{url: "udpin:127.0.0.1:0", id: "gcs", served: served?})
    until(fn -> Aerie.Base.Names.whereis(gateway, :serving, {"main", 1}) end)
    to = Link.snapshot(gateway, "gcs").port
    before = count(wire)
    started = System.monotonic_time(:millisecond)
    at_once = if order == :at_once, do: n, else: 1
    options = [max_concurrency: at_once, timeout: :infinity]
    1..n |> Task.async_stream(&station(to, 200 + &1), options) |> Stream.run()
    ms = System.monotonic_time(:millisecond) - started
    frames = count(wire) - before
    GenServer.stop(sim)
    Process.exit(wire, :normal)

    for pid <- Enum.reverse(parts) do
      Process.unlink(pid)
      GenServer.stop(pid, :shutdown)
    end

    {frames, ms}
  end

  # Between the vehicle and the gateway: counts what the vehicle sends.
  defp wire(port) do
    caller = self()

    pid =
      spawn_link(fn ->
        {:ok, vehicle} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000])
        {:ok, gateway} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000])
        :ok = :gen_udp.connect(gateway, {127, 0, 0, 1}, port)
        {:ok, at} = :inet.port(vehicle)
        send(caller, {self(), at})
        pass(vehicle, gateway, nil, Parser.new(), 0)
      end)

    receive do
      {^pid, at} -> {pid, at}
    end
  end

  defp pass(vehicle, gateway, peer, parser, n) do
    receive do
      {:udp, ^vehicle, ip, port, bytes} ->
        :gen_udp.send(gateway, bytes)
        {frames, parser} = Parser.push_datagram(parser, bytes, nil)
        pass(vehicle, gateway, {ip, port}, parser, n + Enum.count(frames, &(&1.id in @counted)))

      {:udp, ^gateway, _ip, _port, bytes} ->
        :gen_udp.send(vehicle, elem(peer, 0), elem(peer, 1), bytes)
        pass(vehicle, gateway, peer, parser, n)

      {:count, from} ->
        send(from, {self(), n})
        pass(vehicle, gateway, peer, parser, n)

      _other ->
        pass(vehicle, gateway, peer, parser, n)
    end
  end

  defp count(wire) do
    send(wire, {:count, self()})

    receive do
      {^wire, n} -> n
    end
  end

  defp station(port, system) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    say = &:gen_udp.send(socket, MavCodec.encode(&1, system: system, component: 190))
    :ok = say.(%M.Heartbeat{type: 6, autopilot: 8})
    :ok = say.(%M.ParamRequestList{target_system: 1, target_component: 1})
    hear(socket, say, Parser.new(), MapSet.new(), nil)
  end

  defp hear(socket, say, parser, known, total) do
    if total != nil and MapSet.size(known) == total do
      :gen_udp.close(socket)
    else
      receive do
        {:udp, ^socket, _ip, _port, bytes} ->
          {frames, parser} = Parser.push_datagram(parser, bytes, nil)

          values =
            for %{id: 22} = frame <- frames,
                {:ok, m} <- [MavCodec.decode(frame)],
                m.param_index < 65_535,
                do: m

          known = Enum.reduce(values, known, &MapSet.put(&2, &1.param_index))
          hear(socket, say, parser, known, if(values == [], do: total, else: hd(values).param_count))
      after
        @silence_ms ->
          if total,
            do: ask(say, Enum.take(Enum.reject(0..(total - 1), &(&1 in known)), 10)),
            else: say.(%M.ParamRequestList{target_system: 1, target_component: 1})

          hear(socket, say, parser, known, total)
      end
    end
  end

  defp ask(say, missing) do
    for index <- missing,
        do: say.(%M.ParamRequestRead{target_system: 1, target_component: 1, param_index: index, param_id: ""})
  end

  defp until(fun) do
    with value when value in [nil, false] <- fun.() do
      receive do
      after
        5 -> until(fun)
      end
    end
  end
end
