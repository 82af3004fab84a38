defmodule Circuits.UART.Core.Transmit do
  @moduledoc false
  # The sending half: writes, drains and flushes of the transmit direction, one at a time, in the order of the calls. A
  # write goes to the port program in pieces: no request is larger than a packet, and a long write never delays what is not
  # in this queue (reads, signals, close).

  alias Circuits.UART.{Core, State, Wire}

  @piece 8_192
  @max_senders 256

  @spec write(State.t(), GenServer.from(), binary(), non_neg_integer()) :: State.t()
  def write(state, from, data, timeout) do
    case state.framing.add_framing(data, state.framing_state) do
      {:ok, framed, framing_state} ->
        enqueue(%{state | framing_state: framing_state}, from, {:write, IO.iodata_to_binary(framed)}, timeout)

      {:error, reason, framing_state} ->
        State.reply(%{state | framing_state: framing_state}, from, {:error, reason})
    end
  end

  @spec drain(State.t(), GenServer.from(), non_neg_integer()) :: State.t()
  def drain(state, from, limit), do: enqueue(state, from, :drain, limit)

  @spec flush(State.t(), GenServer.from(), :transmit | :both, non_neg_integer()) :: State.t()
  def flush(state, from, direction, limit), do: enqueue(state, from, {:flush, direction}, limit)

  defp enqueue(state, from, what, timeout) do
    if :queue.len(state.senders) >= @max_senders do
      State.reply(state, from, {:error, :eagain})
    else
      sender = %{from: from, what: what, key: make_ref(), deadline: state.now + timeout}

      %{state | senders: :queue.in(sender, state.senders)}
      |> State.act({:start_timer, {:waiting, sender.key}, timeout})
      |> pump()
    end
  end

  @doc "The answer to the pending request of the first sender."
  @spec answered(State.t(), {:ok, binary()} | {:error, atom()}) :: State.t()
  def answered(state, result) do
    {{:value, sender}, rest} = :queue.out(state.senders)
    state = %{state | sending: nil}

    case {result, sender.what} do
      {{:ok, _}, {:write, <<_sent::binary-size(@piece), more::binary>>}} when more != "" ->
        if sender.deadline > state.now do
          pump(%{state | senders: :queue.in_r(%{sender | what: {:write, more}}, rest)})
        else
          done(%{state | senders: rest}, sender, {:error, :eagain})
        end

      {{:ok, _}, _last} ->
        done(%{state | senders: rest}, sender, :ok)

      {{:error, reason}, _any} ->
        done(%{state | senders: rest}, sender, {:error, reason})
    end
  end

  @doc "A waiting sender timed out. The port program times the first one."
  @spec expire(State.t(), reference()) :: State.t()
  def expire(state, key) do
    case {state.sending, :queue.to_list(state.senders)} do
      {id, [%{key: ^key} | _others]} when id != nil ->
        state

      {_sending, senders} ->
        case Enum.split_with(senders, &(&1.key == key)) do
          {[sender], others} ->
            answer(%{state | senders: :queue.from_list(others)}, sender, {:error, :eagain})

          {[], _others} ->
            state
        end
    end
  end

  @doc "Ends all sending with an error."
  @spec abandon(State.t(), atom()) :: State.t()
  def abandon(state, reason) do
    {_what, state} = State.settle(state, state.sending)
    senders = :queue.to_list(state.senders)
    state = %{state | sending: nil, senders: :queue.new()}
    Enum.reduce(senders, state, &answer(&2, &1, {:error, reason}))
  end

  @spec waiting?(State.t()) :: boolean()
  def waiting?(state), do: not :queue.is_empty(state.senders)

  defp pump(%{sending: nil, phase: :open} = state) do
    case :queue.out(state.senders) do
      {{:value, %{what: {:flush, direction}} = sender}, rest} ->
        # No need to wait: the port program does it at once, before anything else.
        %{state | senders: rest}
        |> State.act({:cancel_timer, {:waiting, sender.key}})
        |> Core.Receive.flush(sender.from, direction, max(sender.deadline - state.now, 0))
        |> pump()

      {{:value, sender}, _rest} ->
        timeout = max(sender.deadline - state.now, 0)
        {id, state} = State.request(state, {:send}, timeout, &command(&1, timeout, sender.what))
        %{state | sending: id}

      {:empty, _senders} ->
        state
    end
  end

  defp pump(state), do: state

  defp command(id, timeout, {:write, bytes}) do
    Wire.write(id, timeout, binary_part(bytes, 0, min(byte_size(bytes), @piece)))
  end

  defp command(id, timeout, :drain), do: Wire.drain(id, timeout)

  defp done(state, sender, result), do: state |> answer(sender, result) |> pump()

  defp answer(state, sender, result) do
    state |> State.act({:cancel_timer, {:waiting, sender.key}}) |> State.reply(sender.from, result)
  end
end
