defmodule Aerie.Vehicle.Streams.Sender do
  @moduledoc """
  Sends what `Aerie.Vehicle.Streams.Check` wants to be asked for: one command at a time, because an acknowledgement does not
  say which of several it is for (C8), the next one when it came or after a moment without.
  """

  alias Aerie.Vehicle.Streams.{Arbiter, Check, Line, Meter, Request}

  @set_message_interval 511
  @request_message 512
  @ack_us 600_000

  @accepted 0
  @temporarily_rejected 1
  @unsupported 3
  @in_progress 5

  @doc "The message that is due, if any."
  @spec run(Arbiter.t(), integer(), Request.target()) :: {Arbiter.t(), [struct()]}
  def run(%{queue: []} = arbiter, _now, _target), do: {arbiter, []}

  def run(%{flight: {_what, sent}} = arbiter, now, _target) when now - sent < @ack_us, do: {arbiter, []}

  def run(%{queue: [what | queue]} = arbiter, now, target) do
    case message(%{arbiter | queue: queue, flight: nil}, what, now, target) do
      {arbiter, nil} -> run(arbiter, now, target)
      {arbiter, message} -> {%{arbiter | flight: {what, now}}, [message]}
    end
  end

  defp message(%{legacy: true} = arbiter, {:set, id}, now, target) do
    case Request.group(id) do
      nil -> {missing(arbiter, id), nil}
      group -> message(arbiter, {:group, group}, now, target)
    end
  end

  defp message(arbiter, {:set, id}, now, target) do
    case arbiter.lines do
      %{^id => line} -> {sent(arbiter, line, line.ask, now), Request.set(target, id, line.ask)}
      _not_wanted -> {arbiter, nil}
    end
  end

  # In place of the command the group gets the highest rate that anybody in it is to have, for it sets them all.
  defp message(%{legacy: true} = arbiter, {:group, group}, now, target) do
    members = members(arbiter, group)
    rates = for line <- members, line.hz != nil or asked?(arbiter, line), do: line.ask

    case Enum.max([Map.get(arbiter.groups, group, 0) | rates]) do
      0 -> {arbiter, nil}
      hz -> members |> Enum.reduce(arbiter, &sent(&2, &1, hz, now)) |> group(group, members, hz, target)
    end
  end

  # For a client that asked for it: who is to come more often than that is asked for anew.
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
    case arbiter.lines do
      %{^id => %{state: :query} = line} ->
        line = %{line | next: now + Check.wait(%{line | tries: 1})}
        {Arbiter.put_line(arbiter, line), Request.query(target, id)}

      _no_more ->
        {arbiter, nil}
    end
  end

  defp message(arbiter, {:default, id}, _now, target) do
    if is_map_key(arbiter.lines, id) or arbiter.legacy,
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
    for id <- Map.get(Request.groups(), group, []), line = arbiter.lines[id], do: line
  end

  defp more?(line, hz), do: (line.hz || 0) > hz or (line.set || 0) > hz

  defp asked?(arbiter, line), do: line.state == :asked or {:set, line.id} in arbiter.queue

  defp sent(arbiter, line, hz, now) do
    state = if line.state == :ok, do: :ok, else: :asked
    tries = max(line.tries, 1)
    line = Line.asked(line, hz, Meter.last(arbiter.meter, line.id))
    line = %{line | sent: now, state: state, tries: tries, faster: false}

    Arbiter.put_line(
      %{arbiter | meter: Meter.watch(arbiter.meter, line.id, now)},
      %{line | next: now + Check.wait(line)}
    )
  end

  @doc "See `Aerie.Vehicle.Streams.Arbiter.ack/3`."
  @spec ack(Arbiter.t(), non_neg_integer(), non_neg_integer()) :: Arbiter.t()
  def ack(%{flight: {{kind, id} = what, _sent}} = arbiter, command, result) do
    if command == command(kind) and result != @in_progress,
      do: answered(%{arbiter | flight: nil}, what, id, result),
      else: arbiter
  end

  def ack(arbiter, _command, _result), do: arbiter

  defp command(kind) when kind in [:set, :default], do: @set_message_interval
  defp command(kind) when kind in [:query, :once], do: @request_message
  defp command(:group), do: nil

  defp answered(arbiter, {:set, _id}, _, @accepted), do: %{arbiter | accepted: true}
  defp answered(arbiter, {:set, _id}, _, @temporarily_rejected), do: arbiter

  # It does not know the command, so it gets the old one.
  defp answered(%{accepted: false} = arbiter, {:set, _id} = what, _, @unsupported) do
    %{arbiter | legacy: true, queue: [what | List.delete(arbiter.queue, what)]}
  end

  defp answered(arbiter, {:set, id}, _, _refused), do: missing(arbiter, id)

  defp answered(arbiter, {:once, id}, _, @unsupported),
    do: %{arbiter | once: Map.put(arbiter.once, id, :known)}

  defp answered(arbiter, _what, _id, _result), do: arbiter

  # The vehicle does not have it: no further try.
  defp missing(arbiter, id) do
    case arbiter.lines do
      %{^id => line} -> Arbiter.put_line(arbiter, %{line | state: :missing})
      _not_wanted -> arbiter
    end
  end
end
