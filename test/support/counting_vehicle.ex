defmodule Aerie.CountingVehicle do
  @moduledoc """
  A vehicle that says where it is and counts every frame that arrives: at its socket, where no counter of the gateway can be wrong.
  It obeys nothing, and tells a parameter to who asks for it by its name.
  """

  use GenServer

  alias MavCodec.Command
  alias MavCodec.{Frame, Parser, Signing}
  alias MavCodec.Messages, as: M

  @say_ms 200

  @typedoc "What was counted: message id, sender's system, command (nil of other messages), sequence number."
  @type counted :: {non_neg_integer(), non_neg_integer(), non_neg_integer() | nil, 0..255}

  @doc "Options: `to` (the port of a link; without one it says nothing), `address` (its own and the link's; loopback), `system` (1), `key` (with which it signs), `params` (by name)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @doc "What arrived: how many of each."
  @spec counts(pid()) :: %{counted() => pos_integer()}
  def counts(vehicle), do: GenServer.call(vehicle, :counts, Aerie.Patience.ms())

  @doc "What arrived from these systems."
  @spec counts(pid(), [non_neg_integer()]) :: %{counted() => pos_integer()}
  def counts(vehicle, systems),
    do: Map.filter(counts(vehicle), fn {{_id, system, _command, _seq}, _n} -> system in systems end)

  @doc "The port that it listens at."
  @spec port(pid()) :: :inet.port_number()
  def port(vehicle), do: GenServer.call(vehicle, :port, Aerie.Patience.ms())

  @impl GenServer
  def init(options) do
    address = options[:address] || {127, 0, 0, 1}
    # Where a peer listens for a vehicle that has not spoken.
    {:ok, socket} =
      :gen_udp.open(options[:port] || 0, [:binary, active: true, ip: address, recbuf: 4_194_304])

    signing = if options[:key], do: Signing.new(options[:key])

    state = %{
      socket: socket,
      to: if(options[:to], do: {address, options[:to]}),
      system: options[:system] || 1,
      signing: signing,
      params: options[:params] || %{},
      parser: Parser.new(),
      counts: %{},
      seq: 0
    }

    {:ok, state, {:continue, :say}}
  end

  @impl GenServer
  def handle_continue(:say, state), do: handle_info(:say, state)

  @impl GenServer
  def handle_info(:say, %{to: nil} = state), do: {:noreply, state}

  def handle_info(:say, state) do
    Process.send_after(self(), :say, @say_ms)
    {:noreply, Enum.reduce(said(), state, &say/2)}
  end

  def handle_info({:udp, _socket, _address, _port, bytes}, state) do
    {frames, parser} = Parser.push(state.parser, bytes)

    counts =
      Enum.reduce(frames, state.counts, fn %Frame{} = frame, counts ->
        Map.update(counts, {frame.id, frame.system, Command.of(frame), frame.seq}, 1, &(&1 + 1))
      end)

    values = for frame <- frames, value <- value(frame, state.params), do: value
    {:noreply, Enum.reduce(values, %{state | parser: parser, counts: counts}, &say/2)}
  end

  defp value(%Frame{id: 20} = frame, params) do
    with {:ok, %M.ParamRequestRead{param_id: name}} <- MavCodec.decode(frame),
         %{^name => value} <- params do
      [%M.ParamValue{param_id: name, param_value: value, param_type: 9, param_count: 1, param_index: 0}]
    else
      _another -> []
    end
  end

  defp value(_frame, _params), do: []

  @impl GenServer
  def handle_call(:counts, _from, state), do: {:reply, state.counts, state}

  def handle_call(:port, _from, state) do
    {:ok, port} = :inet.port(state.socket)
    {:reply, port, state}
  end

  defp said do
    [
      %M.Heartbeat{
        type: 2,
        autopilot: 3,
        base_mode: 0x51,
        custom_mode: 4,
        system_status: 3,
        mavlink_version: 3
      },
      %M.GlobalPositionInt{
        time_boot_ms: System.monotonic_time(:millisecond) |> Integer.mod(1_000_000_000),
        lat: 473_970_000,
        lon: 85_450_000,
        alt: 500_000,
        relative_alt: 20_000
      },
      %M.HomePosition{latitude: 473_970_000, longitude: 85_450_000, altitude: 480_000}
    ]
  end

  defp say(message, %{system: system, seq: seq} = state) do
    bytes = MavCodec.encode(message, system: system, component: 1, seq: seq)
    {bytes, signing} = signed(state.signing, bytes, message)
    {address, port} = state.to
    _ = :gen_udp.send(state.socket, address, port, bytes)
    %{state | signing: signing, seq: seq + 1}
  end

  defp signed(nil, bytes, _message), do: {bytes, nil}

  defp signed(signing, bytes, %module{}),
    do: Signing.sign(signing, bytes, MavCodec.Dialects.All.crc_extra(module.id()))
end
