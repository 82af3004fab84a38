defmodule Aerie.Bench.MspCable do
  @moduledoc """
  A whole gateway at a serial line of 115,200 baud (a pseudo terminal) to a simulated Betaflight, which takes a request in 10 ms: what goes over the line,
  and how long a client's request takes meanwhile.
  """

  alias Aerie.Base.Store
  alias Aerie.Bench.{Config, OSProcess}
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Frame
  alias SimVehicle.Msp

  @script Path.expand("msp_line.py", __DIR__)
  @baud 115_200
  @system 7
  @firmware_limit 100

  @doc "The table of so many seconds of polling and so many requests; says why there is none."
  @spec table(pos_integer, pos_integer) :: String.t()
  def table(seconds, count) do
    case System.find_executable("python3") do
      nil -> "no python3: no serial line"
      python -> measured(python, seconds, count)
    end
  end

  defp measured(python, seconds, count) do
    dir = Path.join(System.tmp_dir!(), "aerie-bench-msp-#{System.pid()}")
    File.mkdir_p!(dir)
    {:ok, sim} = Msp.start_link(firmware: :betaflight, uid: @system)
    args = ["-u", @script, "#{Msp.port(sim)}", "#{@baud}"]
    line = Port.open({:spawn_executable, python}, [:binary, :exit_status, args: args])
    "pty " <> device = OSProcess.line(line, "pty ")
    share = free_port()
    url = "msp:#{device},#{@baud}?sysid=#{@system}&share=#{share}"
    gateway = make_ref()
    off = [{"nats.mode", "off"}, {"http.enabled", false}, {"links", [%{"id" => "line", "url" => url}]}]
    {:ok, pid} = Aerie.Gateway.start_link(name: gateway, config: Config.new(dir, off))

    try do
      await(gateway)
      polls = line |> counted(fn -> Process.sleep(seconds * 1_000) end)
      station = station(gateway)
      parameter = times(count, fn -> parameter(station) end)
      program = program(share)
      request = times(count, fn -> request(program) end)
      list = counted(line, fn -> list(station) end)
      rows(polls, parameter, request, list)
    after
      Process.unlink(pid)
      Aerie.Gateway.stop(gateway)
      OSProcess.stop(line)
      File.rm_rf!(dir)
    end
  end

  defp rows(polls, parameter, request, list) do
    """
    polls a second                      #{one(polls.requests)} (#{one(share(polls))} % of the line)
    a client's parameter, ms            #{percentiles(parameter)}
    a program's MSP request, ms         #{percentiles(request)}
    requests a second while a list is read  #{one(list.requests)} (#{one(share(list))} % of the line; the firmware takes #{@firmware_limit})
    """
  end

  # Of the direction that has more.
  defp share(counted), do: 100 * max(counted.to, counted.from) / (@baud / 10)
  defp one(number), do: Float.round(number * 1.0, 1)

  defp percentiles(times) do
    at = fn share -> one(Enum.at(times, round(share * (length(times) - 1)))) end
    "p50 #{at.(0.5)}, p99 #{at.(0.99)} of #{length(times)}"
  end

  defp await(gateway) do
    case Store.vehicle(gateway, {"main", @system}) do
      %{groups: %{health: %{data: %{ready_to_arm: true}}}} ->
        :ok

      _not_yet ->
        Process.sleep(50)
        await(gateway)
    end
  end

  # What went over the line a second.
  defp counted(line, fun) do
    {us, {before, now}} =
      :timer.tc(fn ->
        before = said(line)
        fun.()
        {before, said(line)}
      end)

    [requests, to, from] = Enum.zip_with(now, before, &((&1 - &2) * 1.0e6 / us))
    %{requests: requests, to: to, from: from}
  end

  defp said(line) do
    "line " <> numbers = OSProcess.ask(line, "", "line ")
    numbers |> String.split() |> Enum.map(&String.to_integer/1)
  end

  # In ms, at another moment of the polls each time.
  defp times(count, fun) do
    Enum.sort(
      for n <- 1..count do
        Process.sleep(20 + rem(n * 7_919, 50))
        {us, :ok} = :timer.tc(fun)
        us / 1_000
      end
    )
  end

  defp station(gateway) do
    {:ok, "bench"} = MavRouter.Client.add(gateway, %{url: "tcpin:127.0.0.1:0", id: "bench"})
    %{port: port} = Enum.find(MavRouter.Client.endpoints(gateway), &(&1.id == "bench"))
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, nodelay: true])
    socket
  end

  defp parameter(socket) do
    tell(socket, %M.ParamRequestRead{
      target_system: @system,
      target_component: 1,
      param_id: "p_roll",
      param_index: -1
    })

    hear(socket, MavCodec.Parser.new(), &match?(%M.ParamValue{param_id: "p_roll"}, &1))
  end

  defp list(socket) do
    tell(socket, %M.ParamRequestList{target_system: @system, target_component: 1})
    hear(socket, MavCodec.Parser.new(), &match?(%M.ParamValue{param_index: 1}, &1))
  end

  defp tell(socket, message),
    do: :ok = :gen_tcp.send(socket, MavCodec.encode(message, system: 255, component: 190))

  defp hear(socket, parser, wanted?) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 30_000)
    {frames, parser} = MavCodec.Parser.push(parser, bytes)

    heard? =
      Enum.any?(
        frames,
        &with({:ok, message} <- MavCodec.decode(&1), do: wanted?.(message), else: (_other -> false))
      )

    if heard?, do: :ok, else: hear(socket, parser, wanted?)
  end

  defp program(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, nodelay: true])
    socket
  end

  defp request(socket) do
    :ok = :gen_tcp.send(socket, Frame.encode(%Frame{id: 112}))
    reply(socket, MavCodec.Msp.Parser.new())
  end

  defp reply(socket, parser) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 30_000)
    {frames, parser} = MavCodec.Msp.Parser.push(parser, bytes)
    if Enum.any?(frames, &(&1.id == 112 and &1.direction == :reply)), do: :ok, else: reply(socket, parser)
  end

  defp free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :ok = :gen_tcp.close(socket)
    port
  end
end
