defmodule Aerie.MissionStation do
  @moduledoc """
  A ground station with nothing but a socket and `Protocols.Mission.Transfer`, for transfers against simulated vehicles in real time.
  """

  alias Protocols.Mission.Transfer
  alias MavCodec.Parser

  @us {255, 190}
  @dialect MavCodec.Dialects.All

  defstruct [:socket, :port, :to, :parser, seq: 0]

  @doc "A socket on a free port, to which a vehicle is pointed."
  def open do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 1_000_000])
    {:ok, port} = :inet.port(socket)
    %__MODULE__{socket: socket, port: port, parser: Parser.new(dialects: [@dialect])}
  end

  @doc "Waits for the vehicle's first frame. Other senders are ignored: one may still send to the former owner of our port."
  def meet(%{socket: socket} = station, sim) do
    port = SimVehicle.port(sim)

    receive do
      {:udp, ^socket, ip, ^port, _bytes} -> %{station | to: {ip, port}}
    after
      Aerie.Patience.ms() -> raise "no vehicle came"
    end
  end

  @doc "Carries out a transfer: its result, and the station. `during` may act on the progress."
  def transfer(station, op, type, protocol, options \\ []) do
    now = now()

    {:ok, transfer} =
      Transfer.new(op, type,
        protocol: protocol,
        kind: "copter",
        target: {options[:system] || 1, 1},
        us: @us,
        until: now + (options[:ms] || 120_000) * 1000,
        rtt: Keyword.get(options, :rtt, 5_000)
      )

    loop(station, Transfer.handle(transfer, {:start, now}), options[:during] || fn _progress -> :ok end)
  end

  defp loop(station, {transfer, actions}, during) do
    station = Enum.reduce(actions, station, &act(&1, &2, during))

    case List.keyfind(actions, :result, 0) do
      {:result, result} -> {result, station}
      nil -> wait(station, transfer, during)
    end
  end

  defp act({:send, message}, station, _during) do
    {system, component} = @us

    bytes =
      MavCodec.encode(message, system: system, component: component, seq: station.seq, dialect: @dialect)

    {ip, port} = station.to
    :ok = :gen_udp.send(station.socket, ip, port, bytes)
    %{station | seq: rem(station.seq + 1, 256)}
  end

  defp act({:progress, progress}, station, during) do
    case during.(progress) do
      :cancel -> send(self(), :cancel)
      _other -> :ok
    end

    station
  end

  defp act({:result, _result}, station, _during), do: station

  defp wait(%{socket: socket, to: {ip, port}} = station, transfer, during) do
    left = max(Transfer.wake_at(transfer) - now(), 0)

    receive do
      :cancel ->
        loop(station, Transfer.handle(transfer, {:cancel, now()}), during)

      {:udp, ^socket, ^ip, ^port, bytes} ->
        {frames, parser} = Parser.push_datagram(station.parser, bytes, nil)

        frames
        |> Enum.reduce({transfer, []}, &hear/2)
        |> then(&loop(%{station | parser: parser}, &1, during))
    after
      div(left + 999, 1000) -> loop(station, Transfer.handle(transfer, {:tick, now()}), during)
    end
  end

  defp hear(frame, {transfer, all}) do
    with {:ok, %module{} = message} <- MavCodec.decode(frame, @dialect),
         true <- module in Transfer.listens() do
      {transfer, actions} =
        Transfer.handle(transfer, {:message, message, {frame.system, frame.component}, now()})

      {transfer, all ++ actions}
    else
      _other -> {transfer, all}
    end
  end

  defp now, do: System.monotonic_time(:microsecond)
end
