defmodule Circuits.UART.Core.Transmit do
  @moduledoc false
  # The sending half: writes and drains, one at a time, in the order of the calls. A
  # write goes to the port program in pieces: no request is larger than a packet, and a long write never delays what is not
  # in this queue (reads, changes of options).

  alias Circuits.UART.{State, Wire}

  @piece 8_192
  @max_senders 256

  @spec write(State.t(), GenServer.from(), binary(), non_neg_integer()) :: State.t()
  def write(state, from, data, timeout), do: enqueue(state, from, {:write, data}, timeout)

  @spec drain(State.t(), GenServer.from(), non_neg_integer()) :: State.t()
  def drain(state, from, limit), do: enqueue(state, from, :drain, limit)

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
    case :queue.peek(state.senders) do
      {:value, sender} ->
        timeout = max(sender.deadline - state.now, 0)
        {id, state} = State.request(state, {:send}, timeout, &command(&1, timeout, sender.what))
        %{state | sending: id}

      :empty ->
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
