defmodule Aerie.Vehicle.Services.Streams.Arbiter.Sender do
  @moduledoc """
  Sends the requests that `Aerie.Vehicle.Services.Streams.Arbiter.Check` queued: one command at a time, because an acknowledgement does not say
  which of several it is for (C8). The next one follows the acknowledgement, or a short wait without one.
  """

  alias Aerie.Vehicle.Services.Streams.{Arbiter, Request, WantedMessage}
  alias Aerie.Vehicle.Services.Streams.Arbiter.Groups
  alias MavCodec.Enums.{MavCmd, MavResult}

  @set_message_interval MavCmd.value(:MAV_CMD_SET_MESSAGE_INTERVAL)
  @request_message MavCmd.value(:MAV_CMD_REQUEST_MESSAGE)
  @get_message_interval MavCmd.value(:MAV_CMD_GET_MESSAGE_INTERVAL)
  @ack_us 600_000

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @unsupported MavResult.value(:MAV_RESULT_UNSUPPORTED)
  @in_progress MavResult.value(:MAV_RESULT_IN_PROGRESS)

  @doc "The message that is due, if any."
  @spec run(Arbiter.t(), integer(), Request.target()) :: {Arbiter.t(), [struct()]}
  def run(%{queue: []} = arbiter, _now, _target), do: {arbiter, []}
  def run(%{held: true} = arbiter, _now, _target), do: {arbiter, []}

  def run(%{in_flight: {_what, sent}} = arbiter, now, _target) when now - sent < @ack_us, do: {arbiter, []}

  def run(%{queue: [what | queue]} = arbiter, now, target) do
    case message(%{arbiter | queue: queue, in_flight: nil}, what, now, target) do
      {arbiter, nil} -> run(arbiter, now, target)
      {arbiter, message} -> {%{arbiter | in_flight: {what, now}}, [message]}
    end
  end

  defp message(%{legacy: true} = arbiter, {:set, id}, now, target) do
    case Request.group(id) do
      nil -> {missing(arbiter, id), nil}
      group -> Groups.request(arbiter, group, now, target)
    end
  end

  defp message(arbiter, {:set, id}, now, target) do
    case arbiter.messages do
      %{^id => wanted} ->
        {Arbiter.sent(arbiter, wanted, wanted.ask, now), Request.set(target, id, wanted.ask)}

      _not_wanted ->
        {arbiter, nil}
    end
  end

  defp message(arbiter, {:group, group}, now, target), do: Groups.request(arbiter, group, now, target)
  defp message(arbiter, {:restore, group}, now, target), do: Groups.restore(arbiter, group, now, target)

  defp message(arbiter, {:query, id}, now, target) do
    case arbiter.messages do
      %{^id => %{state: :query} = wanted} ->
        wanted = %{wanted | next: now + WantedMessage.wait(%{wanted | tries: 1})}
        {Arbiter.put(arbiter, wanted), Request.query(target, id)}

      _no_more ->
        {arbiter, nil}
    end
  end

  defp message(arbiter, {:default, id}, _now, target) do
    if is_map_key(arbiter.messages, id) or arbiter.legacy,
      do: {arbiter, nil},
      else: {arbiter, Request.set(target, id, 0)}
  end

  defp message(arbiter, {:once, id}, _now, target) do
    if arbiter.once[id] == :known, do: {arbiter, nil}, else: {arbiter, Request.once(target, id)}
  end

  @doc "See `Aerie.Vehicle.Services.Streams.Arbiter.ack/3`."
  @spec ack(Arbiter.t(), non_neg_integer(), non_neg_integer()) :: Arbiter.t()
  def ack(%{in_flight: {{kind, id} = what, _sent}} = arbiter, command, result) do
    if command == command(kind) and result != @in_progress,
      do: answered(%{arbiter | in_flight: nil}, what, id, result),
      else: arbiter
  end

  def ack(arbiter, _command, _result), do: arbiter

  defp command(kind) when kind in [:set, :default], do: @set_message_interval
  defp command(:query), do: @get_message_interval
  defp command(:once), do: @request_message
  defp command(kind) when kind in [:group, :restore], do: nil

  defp answered(arbiter, {:set, _id}, _, @accepted), do: %{arbiter | accepted: true}
  defp answered(arbiter, {:set, _id}, _, @temporarily_rejected), do: arbiter

  # The vehicle does not know the command, so it gets REQUEST_DATA_STREAM.
  defp answered(%{accepted: false} = arbiter, {:set, _id} = what, _, @unsupported) do
    %{arbiter | legacy: true, queue: [what | List.delete(arbiter.queue, what)]}
  end

  defp answered(arbiter, {:set, id}, _, _refused), do: missing(arbiter, id)

  defp answered(arbiter, {:once, id}, _, @unsupported),
    do: %{arbiter | once: Map.put(arbiter.once, id, :known)}

  defp answered(arbiter, _what, _id, _result), do: arbiter

  # The vehicle does not have this message: no further try.
  defp missing(arbiter, id) do
    case arbiter.messages do
      %{^id => wanted} -> Arbiter.put(arbiter, %{wanted | state: :missing})
      _not_wanted -> arbiter
    end
  end
end
