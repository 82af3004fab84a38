defmodule Circuits.UART.Core do
  @moduledoc false
  # The decisions of the serving process, without the process: `handle(state, event, now)` returns the next state and the
  # actions. This module opens, closes, configures and handles faults; Core.Receive and Core.Transmit are the two directions.
  #
  #     phase: closed ──open──▶ opening ──ok──▶ open ──close──▶ closing ──ok──▶ closed
  #              ▲                 └──error──▶ closed             │
  #              └───────────── gone, program down ◀──────────────┘ (from everywhere)

  alias Circuits.UART.{Core, Options, State, Wire}

  # How long unsent bytes get when the port is closed (ms), as when a terminal is closed.
  @linger 2_000
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

  defp step({:call, from, {:open, name, path, given}}, state) do
    with {:ok, options} <- Options.merge(%{state.options | active: true, id: :name}, given),
         {:ok, framing} <- framing(options, given) do
      state = abandon(state, :ecanceled)
      what = {:open, from, name, options, framing}
      {id, state} = State.request(state, what, @open_limit, &Wire.open(&1, path, options))
      %{state | phase: :opening, transition: id, name: :closed}
    else
      {:error, reason} -> State.reply(state, from, {:error, reason})
    end
  end

  defp step({:call, from, :close}, %{phase: :closed} = state) do
    state |> abandon(:ecanceled) |> State.reply(from, :ok)
  end

  defp step({:call, from, :close}, state) do
    state = abandon(state, :ecanceled)
    {id, state} = State.request(state, {:close, from}, @limit, &Wire.close(&1, @linger))
    %{state | phase: :closing, transition: id, name: :closed}
  end

  defp step({:call, from, {:configure, given}}, state) do
    with {:ok, options} <- Options.merge(state.options, given),
         {:ok, framing} <- framing(options, given) do
      if state.phase == :open do
        {_id, state} =
          State.request(state, {:configure, from, options, framing}, @limit, &Wire.configure(&1, options))

        state
      else
        state |> put_options(options, framing) |> State.reply(from, :ok)
      end
    else
      {:error, reason} -> State.reply(state, from, {:error, reason})
    end
  end

  defp step({:call, from, :configuration}, state) do
    State.reply(state, from, {state.name, Options.to_list(state.options)})
  end

  defp step({:call, from, {:controlling_process, pid}}, state) do
    State.reply(%{state | controlling_process: pid}, from, :ok)
  end

  defp step({:call, from, {:read, timeout}}, state), do: Core.Receive.read(state, from, timeout)

  defp step({:call, from, {:flush, direction, _limit}}, state)
       when direction not in [:receive, :transmit, :both] do
    State.reply(state, from, {:error, :einval})
  end

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

  defp step({:call, from, {:flush, :receive, limit}}, state),
    do: Core.Receive.flush(state, from, :receive, limit)

  defp step({:call, from, {:flush, direction, limit}}, state),
    do: Core.Transmit.flush(state, from, direction, limit)

  defp step({:call, from, :signals}, state) do
    {_id, state} = State.request(state, {:signals, from}, @limit, &Wire.signals/1)
    state
  end

  defp step({:call, from, {:set, line, value}}, state), do: set(state, {:simple, from}, line, value)
  defp step({:call, from, {:send_break, ms}}, state), do: set(state, {:break, from, ms}, :break, true)

  ## The port program

  defp step({:program, {:data, bytes}}, state), do: Core.Receive.data(state, bytes)

  # The port was closed or reopened meanwhile, or is about to be: its end means nothing.
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

  defp step({:timer, :frame}, state), do: Core.Receive.frame_timeout(state)

  defp step({:timer, {:waiting, key}}, state),
    do: state |> Core.Receive.expire(key) |> Core.Transmit.expire(key)

  defp step({:timer, {:break, from}}, %{phase: :open} = state), do: set(state, {:simple, from}, :break, false)
  defp step({:timer, {:break, from}}, state), do: State.reply(state, from, {:error, :ebadf})

  # The program hangs in the kernel or is stopped. A late answer could be mistaken for a later one, so it is given up.
  defp step({:timer, {:request, id}}, state) when is_map_key(state.pending, id) do
    state |> State.act({:kill_program, state.name}) |> program_down(:etimedout)
  end

  defp step({:timer, _settled}, state), do: state

  ## Answers

  defp answered({:open, from, name, options, framing}, id, {:ok, _}, %{transition: id} = state) do
    {pid, _tag} = from

    %{state | phase: :open, name: name, controlling_process: pid}
    |> put_options(options, framing)
    |> State.reply(from, :ok)
  end

  defp answered({:open, from, _name, _options, _framing}, id, {kind, result}, state) do
    state = if state.transition == id, do: %{state | phase: :closed}, else: state
    State.reply(state, from, if(kind == :ok, do: {:error, :ecanceled}, else: {:error, result}))
  end

  defp answered({:close, from}, id, _result, state) do
    state = if state.transition == id, do: %{state | phase: :closed}, else: state
    State.reply(state, from, :ok)
  end

  defp answered({:configure, from, options, framing}, _id, {:ok, _}, state) do
    state |> put_options(options, framing) |> State.reply(from, :ok)
  end

  defp answered({:signals, from}, _id, {:ok, bits}, state) do
    State.reply(state, from, Wire.decode_signals(bits))
  end

  defp answered({:break, from, ms}, _id, {:ok, _}, state) do
    State.act(state, {:start_timer, {:break, from}, ms})
  end

  defp answered({:read}, _id, result, state), do: Core.Receive.answered(state, result)

  defp answered({:flush, from, direction}, _id, result, state),
    do: Core.Receive.flushed(state, from, direction, result)

  defp answered({:send}, _id, result, state), do: Core.Transmit.answered(state, result)
  defp answered(what, _id, {:ok, _}, state), do: State.reply(state, elem(what, 1), :ok)
  defp answered(what, _id, {:error, reason}, state), do: State.reply(state, elem(what, 1), {:error, reason})

  ## Parts

  defp set(state, what, line, value) do
    {_id, state} = State.request(state, what, @limit, &Wire.set(&1, line, value))
    state
  end

  # A fresh state if a framing was given; otherwise a part of a frame is kept.
  defp framing(%Options{framing: {module, args}}, given) do
    if Keyword.has_key?(given, :framing), do: module.init(args), else: {:ok, :keep}
  end

  defp put_options(state, options, :keep), do: Core.Receive.reconfigured(%{state | options: options})

  defp put_options(state, options, framing_state) do
    {module, _args} = options.framing

    %{state | options: options, framing: module, framing_state: framing_state}
    |> State.act({:cancel_timer, :frame})
    |> Core.Receive.reconfigured()
  end

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
    told = Enum.any?(state.pending, fn {_id, what} -> not match?({:close, _from}, what) end)
    state = if was_open, do: gone(state, reason, told), else: abandon(state, reason)

    state = %{state | phase: :closed, name: :closed, discarding: 0, unacknowledged: 0}

    Enum.reduce(Map.keys(state.pending), state, fn id, state ->
      case State.settle(state, id) do
        {{:close, from}, state} -> State.reply(state, from, :ok)
        {what, state} -> State.reply(state, elem(what, 1), {:error, reason})
      end
    end)
  end
end
