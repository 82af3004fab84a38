defmodule Circuits.UART.Core.Receive do
  @moduledoc false
  # The receiving half: messages of active mode, readers of passive mode.
  #
  # In active mode the port program sends received bytes unasked. Each packet costs a credit, which is returned when
  # the packet was handled: a flood stays in the kernel, not in this process's mailbox. In passive mode it sends the
  # bytes of one read on request. At most one such request is pending; its answer serves the readers in order, and
  # readers without data get another request.

  alias Circuits.UART.{State, Wire}

  # How many credits are returned at once (the port program begins with 64).
  @credit_batch 16
  @max_readers 256

  @spec read(State.t(), GenServer.from(), non_neg_integer()) :: State.t()
  def read(state, from, timeout) do
    cond do
      not :queue.is_empty(state.messages) ->
        {{:value, message}, rest} = :queue.out(state.messages)
        State.reply(%{state | messages: rest}, from, {:ok, message})

      state.phase != :open ->
        State.reply(%{state | fault: nil}, from, {:error, state.fault || :ebadf})

      state.options.active ->
        State.reply(state, from, {:error, :einval})

      :queue.len(state.readers) >= @max_readers ->
        State.reply(state, from, {:error, :eagain})

      true ->
        reader = %{from: from, key: make_ref(), deadline: state.now + timeout}

        %{state | readers: :queue.in(reader, state.readers)}
        |> State.act({:start_timer, {:waiting, reader.key}, timeout})
        |> pump()
    end
  end

  @doc "Bytes of active mode, or bytes that were on their way when it ended."
  @spec data(State.t(), binary()) :: State.t()
  def data(state, bytes) do
    state = credit(state)
    if state.phase == :open and state.discarding == 0, do: state |> deliver([bytes]) |> serve(), else: state
  end

  @doc "The answer to the pending read; without bytes if it timed out."
  @spec answered(State.t(), {:ok, binary()} | {:error, atom()}) :: State.t()
  def answered(state, {:ok, bytes}) do
    state = %{state | reading: nil}
    state = if bytes == "" or state.discarding > 0, do: state, else: deliver(state, [bytes])
    state |> serve() |> expire_head() |> pump()
  end

  def answered(state, {:error, reason}) do
    state = %{state | reading: nil}

    case :queue.out(state.readers) do
      {{:value, reader}, rest} -> %{state | readers: rest} |> answer(reader, {:error, reason}) |> pump()
      {:empty, _readers} -> state
    end
  end

  @doc "A waiting reader timed out. The reader of the pending read gets the answer to that."
  @spec expire(State.t(), reference()) :: State.t()
  def expire(state, key) do
    case {state.reading, :queue.to_list(state.readers)} do
      {id, [%{key: ^key} | _others]} when id != nil ->
        state

      {_reading, readers} ->
        case Enum.split_with(readers, &(&1.key == key)) do
          {[reader], others} -> answer(%{state | readers: :queue.from_list(others)}, reader, {:ok, ""})
          {[], _others} -> state
        end
    end
  end

  @doc "Bytes that come before the answer to the flush were received before it, and are dropped as well."
  @spec flush(State.t(), GenServer.from(), non_neg_integer()) :: State.t()
  def flush(state, from, limit) do
    {_id, state} = State.request(state, {:flush, from}, limit, &Wire.flush/1)
    %{state | discarding: state.discarding + 1}
  end

  @spec flushed(State.t(), GenServer.from(), {:ok, binary()} | {:error, atom()}) :: State.t()
  def flushed(state, from, result) do
    result = with {:ok, _nothing} <- result, do: :ok
    State.reply(%{state | discarding: state.discarding - 1, messages: :queue.new()}, from, result)
  end

  @doc "The mode may have changed: active mode has no readers, and sends messages that were not read."
  @spec reconfigured(State.t()) :: State.t()
  def reconfigured(%{options: %{active: true}} = state) do
    messages = :queue.to_list(state.messages)
    %{state | messages: :queue.new()} |> cancel_readers({:error, :ecanceled}) |> deliver(messages)
  end

  def reconfigured(state), do: state

  @doc "Ends all reading with an error."
  @spec abandon(State.t(), atom()) :: State.t()
  def abandon(state, reason) do
    {_what, state} = State.settle(state, state.reading)
    cancel_readers(%{state | reading: nil}, {:error, reason})
  end

  @spec waiting?(State.t()) :: boolean()
  def waiting?(state), do: not :queue.is_empty(state.readers)

  defp deliver(%{options: %{active: true}} = state, messages),
    do: Enum.reduce(messages, state, &State.notify(&2, &1))

  defp deliver(state, messages), do: %{state | messages: Enum.reduce(messages, state.messages, &:queue.in/2)}

  # Received bytes to readers, in order. If that answers the reader of the pending read, the read is cancelled; bytes
  # that it still brings are kept.
  defp serve(state) do
    case {:queue.out(state.messages), :queue.out(state.readers)} do
      {{{:value, message}, messages}, {{:value, reader}, readers}} ->
        state = %{state | messages: messages, readers: readers}
        state = if state.reading, do: State.act(state, {:command, Wire.cancel()}), else: state
        state |> answer(reader, {:ok, message}) |> serve()

      _nothing_to_do ->
        state
    end
  end

  defp expire_head(state) do
    case :queue.out(state.readers) do
      {{:value, %{deadline: deadline} = reader}, rest} when deadline <= state.now ->
        %{state | readers: rest} |> answer(reader, {:ok, ""}) |> expire_head()

      _none ->
        state
    end
  end

  defp pump(%{reading: nil, phase: :open} = state) do
    case :queue.peek(state.readers) do
      {:value, reader} ->
        timeout = max(reader.deadline - state.now, 0)
        {id, state} = State.request(state, {:read}, timeout, &Wire.read(&1, timeout))
        %{state | reading: id}

      :empty ->
        state
    end
  end

  defp pump(state), do: state

  defp cancel_readers(state, result) do
    readers = :queue.to_list(state.readers)
    Enum.reduce(readers, %{state | readers: :queue.new()}, &answer(&2, &1, result))
  end

  defp answer(state, reader, result) do
    state |> State.act({:cancel_timer, {:waiting, reader.key}}) |> State.reply(reader.from, result)
  end

  defp credit(%{unacknowledged: count} = state) when count + 1 < @credit_batch,
    do: %{state | unacknowledged: count + 1}

  defp credit(state), do: State.act(%{state | unacknowledged: 0}, {:command, Wire.credit(@credit_batch)})
end
