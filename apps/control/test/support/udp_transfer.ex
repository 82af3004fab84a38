defmodule Aerie.UdpTransfer do
  @moduledoc "Runs a transfer machine against a vehicle over UDP on the loopback, in the caller's process."

  alias MavCodec.Parser

  @dialect MavCodec.Dialects.Ardupilot
  @us {255, 190}

  @doc "A socket for the vehicle to send to, and its port."
  @spec open() :: {:gen_udp.socket(), :inet.port_number()}
  def open do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000])
    {:ok, port} = :inet.port(socket)
    {socket, port}
  end

  @doc """
  Runs a machine to its end: its result, and the bytes that it read. `port` is the vehicle's. Other senders are ignored: one may
  still send to the former owner of our port.
  """
  @spec run({:gen_udp.socket(), :inet.port_number()}, module(), struct()) :: {term(), binary()}
  def run({socket, port}, module, machine) do
    state = %{
      socket: socket,
      port: port,
      parser: Parser.new(dialects: [@dialect]),
      module: module,
      machine: machine,
      seq: 0,
      data: [],
      result: nil
    }

    state |> event({:start, now()}) |> loop()
  end

  @doc "The clock of the machines."
  @spec now() :: integer()
  def now, do: System.monotonic_time(:microsecond)

  defp loop(%{result: nil, socket: socket, port: port} = state) do
    wait = max(div(state.module.wake_at(state.machine) - now() + 999, 1000), 0)

    receive do
      {:udp, ^socket, _ip, ^port, bytes} -> state |> heard(bytes) |> loop()
    after
      wait -> state |> event({:tick, now()}) |> loop()
    end
  end

  defp loop(state) do
    bytes = state.data |> Enum.sort() |> Enum.map(&elem(&1, 1)) |> IO.iodata_to_binary()
    {state.result, bytes}
  end

  defp heard(state, bytes) do
    {frames, parser} = Parser.push_datagram(state.parser, bytes, nil)

    Enum.reduce(frames, %{state | parser: parser}, fn frame, state ->
      case MavCodec.decode(frame, @dialect) do
        {:ok, message} -> event(state, {:message, message, {frame.system, frame.component}, now()})
        {:error, _unknown} -> state
      end
    end)
  end

  defp event(%{result: nil} = state, event) do
    {machine, actions} = state.module.handle(state.machine, event)
    Enum.reduce(actions, %{state | machine: machine}, &act/2)
  end

  defp event(state, _late), do: state

  defp act({:send, messages}, state), do: Enum.reduce(messages, state, &transmit/2)
  defp act({:data, offset, bytes}, state), do: %{state | data: [{offset, bytes} | state.data]}
  defp act({:progress, _done, _total}, state), do: state
  defp act({:done, result}, state), do: %{state | result: result}

  defp transmit(message, state) do
    {system, component} = @us
    bytes = MavCodec.encode(message, system: system, component: component, seq: state.seq, dialect: @dialect)
    :ok = :gen_udp.send(state.socket, {127, 0, 0, 1}, state.port, bytes)
    %{state | seq: Bitwise.band(state.seq + 1, 0xFF)}
  end
end
