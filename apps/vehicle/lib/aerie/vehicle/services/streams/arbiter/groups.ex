defmodule Aerie.Vehicle.Services.Streams.Arbiter.Groups do
  @moduledoc """
  The groups of REQUEST_DATA_STREAM, as `Aerie.Vehicle.Services.Streams.Arbiter` requests them.

  A group that clients want is requested once, and again after each reboot. Its request changes all its members, also those
  that nobody wants. So these are measured for three seconds before it. When clients want a group at a lower rate, or not any
  more, it is requested at the rate measured then, because an ArduPilot that is asked for the default (an interval of 0)
  returns to the last rate of the group, and some keep this rate in a parameter. Wanted members that had another rate get it
  back with their own request.
  """

  alias Aerie.Vehicle.Services.Streams.{Arbiter, Meter, Request, WantedMessage}

  # Long enough for the whole number of messages per second that a group can have.
  @measure_us 3_000_000
  # Rates that differ by less are the same, because a measured one is not exact.
  @same_hz 0.5
  @same 0.1

  @doc "Clients want these groups now (rates by group). One that they want less than was requested is reset after a while."
  @spec demand(Arbiter.t(), %{non_neg_integer() => number()}) :: Arbiter.t()
  def demand(arbiter, groups) do
    less = for {group, hz} <- arbiter.sent_groups, hz > Map.get(groups, group, 0), do: {:group, group}
    resets = Enum.reduce(less, arbiter.resets, &Map.put_new(&2, &1, nil))
    %{arbiter | groups: groups, resets: resets}
  end

  @doc "Queues the groups that have to be requested at `now`."
  @spec check(Arbiter.t(), integer()) :: Arbiter.t()
  def check(%{held: true} = arbiter, _now) do
    # Rates measured while nothing may be requested are not those that the vehicle sends by itself.
    %{arbiter | before: Map.reject(arbiter.before, fn {_group, rate} -> rate == :measuring end)}
  end

  def check(arbiter, now) do
    Enum.reduce(arbiter.groups, arbiter, fn {group, hz}, arbiter ->
      # A message may have become one that nobody else wants.
      meter = Enum.reduce(others(arbiter, group), arbiter.meter, &Meter.ensure(&2, &1, now))
      arbiter = %{arbiter | meter: meter}
      if Map.get(arbiter.sent_groups, group, 0) >= hz, do: arbiter, else: measured(arbiter, group, now)
    end)
  end

  defp measured(arbiter, group, now) do
    case arbiter.before do
      %{^group => :measuring} ->
        rates = for id <- others(arbiter, group), do: Meter.rate(arbiter.meter, id, now, @measure_us)

        if nil in rates,
          do: arbiter,
          else: Arbiter.enqueue(before(arbiter, group, whole(rates)), {:group, group})

      %{^group => _hz} ->
        Arbiter.enqueue(arbiter, {:group, group})

      _new ->
        meter = Enum.reduce(others(arbiter, group), arbiter.meter, &Meter.watch(&2, &1, now))
        measured(before(%{arbiter | meter: meter}, group, :measuring), group, now)
    end
  end

  defp before(arbiter, group, rate), do: %{arbiter | before: Map.put(arbiter.before, group, rate)}

  @doc "The reset of a group is due."
  @spec reset(Arbiter.t(), non_neg_integer()) :: Arbiter.t()
  def reset(arbiter, group) do
    if Map.get(arbiter.sent_groups, group, 0) > Map.get(arbiter.groups, group, 0),
      do: Arbiter.enqueue(arbiter, {:restore, group}),
      else: arbiter
  end

  @doc "The request for a group, nil if none is needed."
  @spec request(Arbiter.t(), non_neg_integer(), integer(), Request.target()) ::
          {Arbiter.t(), struct() | nil}
  # All members get the rate, so it is the highest that is wanted of any of them.
  def request(%{legacy: true} = arbiter, group, now, target) do
    rates =
      for wanted <- members(arbiter, group), wanted.hz != nil or asked?(arbiter, wanted), do: wanted.ask

    case Enum.max([Map.get(arbiter.groups, group, 0) | rates]) do
      0 -> {arbiter, nil}
      hz -> set_all(arbiter, group, hz, now, target)
    end
  end

  # Members that are wanted at a higher rate are requested again.
  def request(arbiter, group, now, target) do
    case arbiter.groups do
      %{^group => hz} ->
        {more, less} = Enum.split_with(members(arbiter, group), &more?(&1, hz))
        arbiter = Enum.reduce(less, arbiter, &Arbiter.sent(&2, &1, hz, now))
        arbiter = Enum.reduce(more, arbiter, &Arbiter.enqueue(&2, {:set, &1.id}))
        {done(arbiter, group), Request.group(target, group, hz)}

      _nobody ->
        {arbiter, nil}
    end
  end

  @doc "The request that gives a group its rate before the first one back, or what clients still want if that is more."
  @spec restore(Arbiter.t(), non_neg_integer(), integer(), Request.target()) :: {Arbiter.t(), struct() | nil}
  def restore(%{legacy: true} = arbiter, group, now, target) do
    rates = for wanted <- members(arbiter, group), wanted.set != nil, do: due(wanted)
    set_all(arbiter, group, whole([least(arbiter, group) | rates]), now, target)
  end

  def restore(arbiter, group, now, target) do
    members = Enum.reject(members(arbiter, group), &(&1.state in [:missing, :yielded]))
    hz = rate(arbiter, group, members)
    {same, other} = Enum.split_with(members, &restored?(&1, hz))
    # One that came fast enough with the group was never requested.
    same = for %{set: set} = wanted when set != nil and hz != nil <- same, do: wanted
    arbiter = Enum.reduce(same, done(arbiter, group), &Arbiter.sent(&2, &1, hz, now))
    {Enum.reduce(other, arbiter, &own(&2, &1)), hz && Request.group(target, group, hz)}
  end

  # Whether a member needs no request of its own.
  defp restored?(%{set: nil} = wanted, hz), do: due(wanted) <= (hz || due(wanted))
  defp restored?(wanted, hz), do: same?(due(wanted), hz || wanted.set)

  # 0 stops it; nil: the group is not requested.
  defp rate(arbiter, group, members) do
    least = least(arbiter, group)

    cond do
      least > 0 -> least
      # They came only because the group was requested.
      Enum.any?(others(arbiter, group), &Meter.last(arbiter.meter, &1)) -> 0
      true -> with 0 <- whole(for(%{initial: hz} when hz != nil <- members, do: hz)), do: nil
    end
  end

  defp least(arbiter, group),
    do: max(Map.get(arbiter.groups, group, 0), whole([Map.get(arbiter.before, group, 0)]))

  # It is next, so that a member whose group was stopped pauses only for a moment.
  defp own(arbiter, wanted) do
    arbiter = Arbiter.put(arbiter, %{wanted | ask: due(wanted), state: :asked, tries: 1})
    %{arbiter | queue: [{:set, wanted.id} | List.delete(arbiter.queue, {:set, wanted.id})]}
  end

  defp set_all(arbiter, group, hz, now, target) do
    members = members(arbiter, group)
    arbiter = %{arbiter | queue: arbiter.queue -- Enum.map(members, &{:set, &1.id})}
    arbiter = Enum.reduce(members, arbiter, &Arbiter.sent(&2, &1, hz, now))
    {done(arbiter, group), Request.group(target, group, hz)}
  end

  # The recorded request is the clients' rate. Unwanted members are watched while there is one.
  defp done(arbiter, group) do
    case arbiter.groups do
      %{^group => hz} ->
        %{arbiter | sent_groups: Map.put(arbiter.sent_groups, group, hz)}

      _nobody ->
        meter = Enum.reduce(others(arbiter, group), arbiter.meter, &Meter.ignore(&2, &1))
        %{arbiter | meter: meter, sent_groups: Map.delete(arbiter.sent_groups, group)}
    end
  end

  defp ids(group), do: Map.get(Request.groups(), group, [])
  defp members(arbiter, group), do: for(id <- ids(group), wanted = arbiter.messages[id], do: wanted)
  defp others(arbiter, group), do: for(id <- ids(group), not is_map_key(arbiter.messages, id), do: id)

  # The rate that a message has without the group.
  defp due(%{set: nil} = wanted), do: wanted.hz || 0
  defp due(wanted), do: WantedMessage.least(wanted)

  defp same?(a, b), do: abs(a - b) <= max(@same_hz, b * @same)
  defp more?(wanted, hz), do: (wanted.hz || 0) > hz or (wanted.set || 0) > hz
  defp asked?(arbiter, wanted), do: wanted.state == :asked or {:set, wanted.id} in arbiter.queue

  # The highest rate as REQUEST_DATA_STREAM can express it: what comes at all is not rounded to a stop.
  defp whole(rates) do
    case Enum.max([0 | Enum.filter(rates, &is_number/1)]) do
      hz when hz > 0 -> max(round(hz), 1)
      _none -> 0
    end
  end
end
