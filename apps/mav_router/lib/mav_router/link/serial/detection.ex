defmodule MavRouter.Link.Serial.Detection do
  @moduledoc """
  Performs the actions of `MavRouter.Link.Serial.Detector`: one search, in the process that calls it. Each port has a process of
  its own (`MavRouter.Link.Serial.UartProcess`) that opens it and reads on request, so a port that hangs delays no other, and a port
  that floods fills no mailbox.
  """

  alias MavRouter.Link.Serial.Detector
  alias MavRouter.Link.Serial.Finding
  alias Aerie.Base.Net.SerialPorts
  alias MavRouter.Link.Serial.UartProcess

  @tick_ms 250
  # New ports may appear during the search.
  @list_ms 1_000

  @doc """
  Searches; returns the holder of the port, which is open but not being read, and the bytes that were received.

  Options: those of `Aerie.Base.Net.SerialPorts` as `:ports`, and `:bauds`, `:hint` and `:ask` of `MavRouter.Link.Serial.Detector.new/1`.
  """
  @spec run(keyword) :: {:ok, pid, Finding.t(), binary} | {:error, {:undetected, [Finding.t()]}}
  def run(options) do
    # A holder that crashes costs its port, not the search; the holders end with this process.
    Process.flag(:trap_exit, true)
    names = Keyword.fetch!(options, :ports)

    state = %{
      names: names,
      detector: Detector.new(options),
      holders: %{},
      keys: %{},
      list_at: nil,
      result: nil
    }

    result = state |> list_ports() |> loop()
    Process.flag(:trap_exit, false)
    result
  end

  defp loop(%{result: nil} = state) do
    receive do
      {:serial, holder, event} when is_map_key(state.keys, holder) ->
        state |> step({state.keys[holder], event}) |> loop()

      # From a port that was closed meanwhile.
      {:serial, _holder, _event} ->
        loop(state)

      # What could not be written has no answer.
      {:serial_written, _holder, _bytes, _result} ->
        loop(state)

      {:EXIT, holder, reason} when is_map_key(state.keys, holder) ->
        {key, keys} = Map.pop(state.keys, holder)
        state = %{state | keys: keys, holders: Map.delete(state.holders, key)}
        state |> step({key, {:failed, reason}}) |> loop()

      {:EXIT, _other, :normal} ->
        loop(state)

      {:EXIT, _other, reason} ->
        exit(reason)
    after
      @tick_ms -> state |> step(:tick) |> list_ports() |> loop()
    end
  end

  defp loop(%{result: result}), do: result

  defp list_ports(%{list_at: at} = state) do
    if state.result == nil and (at == nil or now() >= at) do
      step(%{state | list_at: now() + @list_ms}, {:ports, SerialPorts.list(state.names)})
    else
      state
    end
  end

  defp step(%{result: nil} = state, event) do
    {detector, actions} = Detector.handle(state.detector, event, now())
    Enum.reduce(actions, %{state | detector: detector}, &act/2)
  end

  defp act({:open, key, path, baud}, %{holders: holders} = state) when is_map_key(holders, key) do
    UartProcess.listen(Map.fetch!(holders, key), path, baud)
    state
  end

  defp act({:open, key, path, baud}, state) do
    {:ok, holder} = UartProcess.start_link()
    UartProcess.listen(holder, path, baud)
    %{state | holders: Map.put(state.holders, key, holder), keys: Map.put(state.keys, holder, key)}
  end

  defp act({:set, key, baud}, state), do: request(state, key, &UartProcess.set(&1, baud))
  defp act({:read, key, ms}, state), do: request(state, key, &UartProcess.read(&1, ms))
  defp act({:write, key, bytes}, state), do: request(state, key, &UartProcess.write(&1, bytes))

  defp act({:close, key}, state) do
    case Map.pop(state.holders, key) do
      {nil, _holders} ->
        state

      {holder, holders} ->
        UartProcess.stop(holder)
        %{state | holders: holders, keys: Map.delete(state.keys, holder)}
    end
  end

  defp act({:found, key, finding, bytes}, state) do
    %{state | result: {:ok, Map.fetch!(state.holders, key), finding, bytes}}
  end

  defp act({:failed, findings}, state), do: %{state | result: {:error, {:undetected, findings}}}

  defp request(state, key, request) do
    with %{^key => holder} <- state.holders, do: request.(holder)
    state
  end

  defp now, do: System.monotonic_time(:millisecond)
end
