defmodule Aerie.Vehicle.Streams.Sender do
  @moduledoc """
  Sends the requests that `Aerie.Vehicle.Streams.Check` queued: one command at a time, because an acknowledgement does not say
  which of several it is for (C8). The next one follows the acknowledgement, or a short wait without one.
  """

  alias Aerie.Vehicle.Streams.{Arbiter, Check, Meter, Request, WantedMessage}
  alias MavCodec.Enums.{MavCmd, MavResult}

  @set_message_interval MavCmd.value(:MAV_CMD_SET_MESSAGE_INTERVAL)
  @request_message MavCmd.value(:MAV_CMD_REQUEST_MESSAGE)
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
      group -> message(arbiter, {:group, group}, now, target)
    end
  end

  defp message(arbiter, {:set, id}, now, target) do
    case arbiter.messages do
      %{^id => wanted} -> {sent(arbiter, wanted, wanted.ask, now), Request.set(target, id, wanted.ask)}
      _not_wanted -> {arbiter, nil}
    end
  end

  # REQUEST_DATA_STREAM sets all messages of a group, so it gets the highest rate that is wanted of any of them.
  defp message(%{legacy: true} = arbiter, {:group, group}, now, target) do
    members = members(arbiter, group)
    rates = for wanted <- members, wanted.hz != nil or asked?(arbiter, wanted), do: wanted.ask

    case Enum.max([Map.get(arbiter.groups, group, 0) | rates]) do
      0 -> {arbiter, nil}
      hz -> members |> Enum.reduce(arbiter, &sent(&2, &1, hz, now)) |> group(group, members, hz, target)
    end
  end

  # A client's request for a group. Messages of it that are wanted at a higher rate are requested again.
  defp message(arbiter, {:group, group}, now, target) do
    case arbiter.groups do
      %{^group => hz} ->
        {more, less} = Enum.split_with(members(arbiter, group), &more?(&1, hz))
        arbiter = less |> Enum.filter(&(&1.ask <= hz)) |> Enum.reduce(arbiter, &sent(&2, &1, hz, now))
        {arbiter, message} = group(arbiter, group, [], hz, target)
        {Enum.reduce(more, arbiter, &Arbiter.enqueue(&2, {:set, &1.id})), message}

      _nobody ->
        {arbiter, nil}
    end
  end

  defp message(arbiter, {:query, id}, now, target) do
    case arbiter.messages do
      %{^id => %{state: :query} = wanted} ->
        wanted = %{wanted | next: now + Check.wait(%{wanted | tries: 1})}
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

  defp group(arbiter, group, members, hz, target) do
    queue = arbiter.queue -- Enum.map(members, &{:set, &1.id})
    sent = Map.put(arbiter.sent_groups, group, hz)
    {%{arbiter | queue: queue, sent_groups: sent}, Request.group(target, group, hz)}
  end

  defp members(arbiter, group) do
    for id <- Map.get(Request.groups(), group, []), wanted = arbiter.messages[id], do: wanted
  end

  defp more?(wanted, hz), do: (wanted.hz || 0) > hz or (wanted.set || 0) > hz

  defp asked?(arbiter, wanted), do: wanted.state == :asked or {:set, wanted.id} in arbiter.queue

  defp sent(arbiter, wanted, hz, now) do
    state = if wanted.state == :ok, do: :ok, else: :asked
    tries = max(wanted.tries, 1)
    wanted = WantedMessage.asked(wanted, hz, Meter.last(arbiter.meter, wanted.id))
    wanted = %{wanted | state: state, tries: tries, faster: false}

    Arbiter.put(
      %{arbiter | meter: Meter.watch(arbiter.meter, wanted.id, now)},
      %{wanted | next: now + Check.wait(wanted)}
    )
  end

  @doc "See `Aerie.Vehicle.Streams.Arbiter.ack/3`."
  @spec ack(Arbiter.t(), non_neg_integer(), non_neg_integer()) :: Arbiter.t()
  def ack(%{in_flight: {{kind, id} = what, _sent}} = arbiter, command, result) do
    if command == command(kind) and result != @in_progress,
      do: answered(%{arbiter | in_flight: nil}, what, id, result),
      else: arbiter
  end

  def ack(arbiter, _command, _result), do: arbiter

  defp command(kind) when kind in [:set, :default], do: @set_message_interval
  defp command(kind) when kind in [:query, :once], do: @request_message
  defp command(:group), do: nil

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
