defmodule Circuits.UART.Core do
  @moduledoc false
  # The decisions of the serving process, without the process: `handle(state, event, now)` returns the next state and the
  # actions. This module opens, closes, configures and handles faults; Core.Receive and Core.Transmit are the two directions.
  #
  #     phase: closed ──open──▶ opening ──ok──▶ open
  #              ▲                 └──error──▶ closed
  #              └───────────── gone, program down (from everywhere)

  alias Circuits.UART.{Core, Options, State, Wire}

  @open_limit 10_000
  @limit 5_000

  @type event ::
          {:call, GenServer.from(), term()}
          | {:program, Wire.event()}
          | {:program_down, atom()}
          | {:timer, State.timer()}

  @doc "`now` is monotonic milliseconds."
  @spec handle(State.t(), event(), integer()) :: {State.t(), [State.action()]}
  def handle(state, event, now) do
    state = step(event, %{state | now: now})
    {%{state | actions: []}, Enum.reverse(state.actions)}
  end

  ## Calls

  defp step({:call, from, {:open, path, given}}, state) do
    case Options.merge(%{state.options | active: true, id: :name}, given) do
      {:ok, options} ->
        what = {:open, from, path, options}

        {id, state} =
          state |> abandon(:ecanceled) |> State.request(what, @open_limit, &Wire.open(&1, path, options))

        %{state | phase: :opening, transition: id, name: :closed}

      {:error, reason} ->
        State.reply(state, from, {:error, reason})
    end
  end

  defp step({:call, from, {:configure, given}}, %{phase: phase} = state) do
    case Options.merge(state.options, given) do
      {:ok, options} when phase == :open ->
        {_id, state} =
          State.request(state, {:configure, from, options}, @limit, &Wire.configure(&1, options))

        state

      {:ok, options} ->
        state |> put_options(options) |> State.reply(from, :ok)

      {:error, reason} ->
        State.reply(state, from, {:error, reason})
    end
  end

  defp step({:call, from, :configuration}, state) do
    State.reply(state, from, {state.name, Options.to_list(state.options)})
  end

  defp step({:call, from, {:controlling_process, pid}}, state) do
    State.reply(%{state | controlling_process: pid}, from, :ok)
  end

  defp step({:call, from, {:read, timeout}}, state), do: Core.Receive.read(state, from, timeout)

  # Everything below needs an open port.
  defp step({:call, from, {:write, _data, _timeout}}, %{phase: phase, fault: fault} = state)
       when phase != :open and fault != nil do
    State.reply(%{state | fault: nil}, from, {:error, fault})
  end

  defp step({:call, from, _any}, %{phase: phase} = state) when phase != :open do
    State.reply(state, from, {:error, :ebadf})
  end

  defp step({:call, from, {:write, data, timeout}}, state),
    do: Core.Transmit.write(state, from, data, timeout)

  defp step({:call, from, {:drain, limit}}, state), do: Core.Transmit.drain(state, from, limit)

  defp step({:call, from, {:flush, limit}}, state), do: Core.Receive.flush(state, from, limit)

  ## The port program

  defp step({:program, {:data, bytes}}, state), do: Core.Receive.data(state, bytes)

  # The port is being reopened: the end of the one before means nothing.
  defp step({:program, {:gone, _told, _reason}}, %{phase: phase} = state) when phase != :open, do: state
  defp step({:program, {:gone, told, reason}}, state), do: gone(state, reason, told)

  defp step({:program, {kind, id, result}}, state) do
    case State.settle(state, id) do
      {nil, state} -> state
      {what, state} -> answered(what, id, {kind, result}, state)
    end
  end

  defp step({:program_down, reason}, state), do: program_down(state, reason)

  ## Timers

  defp step({:timer, {:waiting, key}}, state),
    do: state |> Core.Receive.expire(key) |> Core.Transmit.expire(key)

  # The program hangs in the kernel or is stopped. A late answer could be mistaken for a later one, so it is given up.
  defp step({:timer, {:request, id}}, state) when is_map_key(state.pending, id) do
    state |> State.act({:kill_program, state.name}) |> program_down(:etimedout)
  end

  defp step({:timer, _settled}, state), do: state

  ## Answers

  defp answered({:open, from, name, options}, id, {:ok, _}, %{transition: id} = state) do
    {pid, _tag} = from

    %{state | phase: :open, name: name, controlling_process: pid}
    |> put_options(options)
    |> State.reply(from, :ok)
  end

  defp answered({:open, from, _name, _options}, id, {kind, result}, state) do
    state = if state.transition == id, do: %{state | phase: :closed}, else: state
    State.reply(state, from, if(kind == :ok, do: {:error, :ecanceled}, else: {:error, result}))
  end

  defp answered({:configure, from, options}, _id, {:ok, _}, state) do
    state |> put_options(options) |> State.reply(from, :ok)
  end

  defp answered({:read}, _id, result, state), do: Core.Receive.answered(state, result)

  defp answered({:flush, from}, _id, result, state), do: Core.Receive.flushed(state, from, result)
  defp answered({:send}, _id, result, state), do: Core.Transmit.answered(state, result)
  defp answered(what, _id, {:error, reason}, state), do: State.reply(state, elem(what, 1), {:error, reason})

  ## Parts

  defp put_options(state, options), do: Core.Receive.reconfigured(%{state | options: options})

  # Ends all waiting calls, and drops what was received.
  defp abandon(state, reason) do
    state = state |> Core.Receive.abandon(reason) |> Core.Transmit.abandon(reason)
    %{state | fault: nil, messages: :queue.new()}
  end

  defp gone(%{messages: messages} = state, reason, told) do
    told = told or Core.Receive.waiting?(state) or Core.Transmit.waiting?(state)
    state = abandon(state, reason)
    state = if state.options.active, do: State.notify(state, {:error, reason}), else: state

    # What was received before can still be read.
    fault = if state.options.active or told, do: nil, else: reason
    %{state | phase: :closed, name: :closed, fault: fault, messages: messages}
  end

  defp program_down(state, reason) do
    was_open = state.phase == :open
    told = state.pending != %{}
    state = if was_open, do: gone(state, reason, told), else: abandon(state, reason)

    state = %{state | phase: :closed, name: :closed, discarding: 0, unacknowledged: 0}

    Enum.reduce(Map.keys(state.pending), state, fn id, state ->
      {what, state} = State.settle(state, id)
      State.reply(state, elem(what, 1), {:error, reason})
    end)
  end
end
