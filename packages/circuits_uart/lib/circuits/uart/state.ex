defmodule Circuits.UART.State do
  @moduledoc false
  # The state of the serving process, and the actions of the current step, newest first. The functions of
  # `Circuits.UART.Core` and its two halves work on it; `Circuits.UART.Server` performs the actions.

  alias Circuits.UART.{Options, Wire}

  # How much longer than its limit the port program may take to answer before it is given up. A busy machine may let
  # a healthy one stand still for seconds.
  @slack 10_000

  defstruct phase: :closed,
            # The open whose answer decides the phase: the latest one.
            transition: nil,
            name: :closed,
            options: %Options{},
            controlling_process: nil,
            # Why the port closed by itself, if no caller has been told yet (passive mode).
            fault: nil,
            # Requests that the port program has not answered: id => request.
            pending: %{},
            last_id: 0,
            # Receiving (Core.Receive)
            messages: :queue.new(),
            reading: nil,
            readers: :queue.new(),
            discarding: 0,
            unacknowledged: 0,
            # Sending (Core.Transmit)
            sending: nil,
            senders: :queue.new(),
            now: 0,
            actions: []

  @type t :: %__MODULE__{}
  @type timer :: {:request, Wire.id()} | {:waiting, reference()}
  @type action ::
          {:reply, GenServer.from(), term()}
          | {:command, iodata()}
          | {:send, pid(), id :: {:name, String.t()} | :pid, data :: term()}
          | {:start_timer, timer(), ms :: non_neg_integer()}
          | {:cancel_timer, timer()}
          | {:kill_program, name :: String.t() | :closed}

  @spec act(t(), action()) :: t()
  def act(state, action), do: %{state | actions: [action | state.actions]}

  @spec reply(t(), GenServer.from(), term()) :: t()
  def reply(state, from, result), do: act(state, {:reply, from, result})

  @doc "A message to the controlling process, in active mode. The server adds the id."
  @spec notify(t(), term()) :: t()
  def notify(%{controlling_process: nil} = state, _data), do: state
  def notify(state, data), do: act(state, {:send, state.controlling_process, message_id(state), data})

  defp message_id(%{options: %{id: :name}, name: name}), do: {:name, name}
  defp message_id(_state), do: :pid

  @doc "A request to the port program; its answer comes back with `what`. It may take `limit` ms."
  @spec request(t(), what :: tuple(), limit :: non_neg_integer(), (Wire.id() -> iodata())) :: {Wire.id(), t()}
  def request(state, what, limit, command) do
    id = rem(state.last_id, 0xFFFFFFFF) + 1
    state = %{state | last_id: id, pending: Map.put(state.pending, id, what)}
    {id, state |> act({:command, command.(id)}) |> act({:start_timer, {:request, id}, limit + @slack})}
  end

  @doc "Ends a request, answered or not; a later answer is ignored."
  @spec settle(t(), Wire.id()) :: {what :: tuple() | nil, t()}
  def settle(state, id) do
    case Map.pop(state.pending, id) do
      {nil, _pending} -> {nil, state}
      {what, pending} -> {what, act(%{state | pending: pending}, {:cancel_timer, {:request, id}})}
    end
  end
end
