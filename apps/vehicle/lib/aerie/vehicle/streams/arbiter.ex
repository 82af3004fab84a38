defmodule Aerie.Vehicle.Streams.Arbiter do
  @moduledoc """
  Decides what to ask a vehicle for, so that everybody gets what they want and nobody is fought. A pure value.

  What is wanted: by the gateway, some messages at any rate (`floor/0`) and those of `mavlink.streams` at theirs; by each
  client, what it asked for. Of each message the highest rate counts, for the rate belongs to the link and not to who asked
  (M2).

  What comes as wanted is not asked for. What does not is asked for by SET_MESSAGE_INTERVAL, one command at a time, and then
  measured: an acknowledgement proves nothing (M2). Three tries, with growing pauses; a vehicle that does not know the
  command, or heeds none, gets REQUEST_DATA_STREAM. After that it is left alone until it reboots (R6) or the wants change
  (M3).

  What nobody wants any more is given back: what came by itself before anybody asked comes as often as then, all else at the
  vehicle's default.

  What came as asked for and then comes too seldom was changed by somebody, or does not get through. The vehicle is asked
  which (MESSAGE_INTERVAL). Set as we set it: the link is too slow, asking again would make it no faster. Set otherwise: it
  is asked for once more; changed again within two minutes, it is left to whoever changes it, and told.

  Each function takes the time (us) as `now` or `at`. `Check` judges, `Sender` sends.
  """

  alias Aerie.Vehicle.Streams.{Check, Line, Meter, Request, Sender}

  # Message id => rate to ask for when it does not come by itself.
  @floor %{245 => 2, 33 => 4, 30 => 4, 74 => 2, 1 => 1, 24 => 1, 147 => 0.5, 42 => 1, 65 => 1}
  # What comes once when asked for. HOME_POSITION comes by itself when it changes.
  @once [148, 242]

  @grace_us 2_000_000

  defstruct lines: %{},
            meter: Meter.new(),
            gateway: %{},
            wants: %{},
            groups: %{},
            sent_groups: %{},
            once: %{},
            releases: %{},
            begun: nil,
            checked: nil,
            queue: [],
            flight: nil,
            accepted: false,
            obeyed: false,
            legacy: false,
            notices: []

  @typedoc """
  - `once`: id => `{tries, next}`, or `:known`
  - `releases`: id => when what nobody wants any more is given back
  - `queue`, `flight`: what is to be sent, what waits for its acknowledgement
  - `accepted`, `obeyed`: whether SET_MESSAGE_INTERVAL was ever acknowledged, whether a rate ever followed it
  - `legacy`: whether REQUEST_DATA_STREAM has taken its place
  """
  @type t :: %__MODULE__{}

  @typedoc "A rate was changed under us: `how` is `:slower` or `:faster`; `yielded` when it is left to who changed it."
  @type notice :: %{
          id: non_neg_integer(),
          asked: number(),
          measured: number() | nil,
          how: :slower | :faster,
          yielded: boolean()
        }

  @doc "Messages that the gateway wants to come at all, with the rate that it asks for."
  @spec floor() :: %{non_neg_integer() => number()}
  def floor, do: @floor

  @doc "Nothing heard yet. `gateway`: messages per second that the gateway wants at least, by message id."
  @spec new(%{non_neg_integer() => number()}) :: t()
  def new(gateway \\ %{}), do: with_lines(%__MODULE__{gateway: gateway, once: once()})

  defp once, do: Map.new(@once, &{&1, {0, nil}})

  @doc "A message is to come once, if it did not do so already."
  @spec once(t(), non_neg_integer()) :: t()
  def once(arbiter, id), do: %{arbiter | once: Map.put_new(arbiter.once, id, {0, nil})}

  @doc "A message of the autopilot came by a link."
  @spec heard(t(), term(), non_neg_integer(), integer()) :: t()
  def heard(%{begun: nil} = arbiter, link, id, at),
    do: heard(%{arbiter | begun: at + @grace_us}, link, id, at)

  def heard(%{once: once} = arbiter, _link, id, _at) when is_map_key(once, id),
    do: %{arbiter | once: Map.put(arbiter.once, id, :known)}

  def heard(%{lines: lines} = arbiter, link, id, at) when is_map_key(lines, id) do
    %{arbiter | meter: arbiter.meter |> Meter.ensure(id, at) |> Meter.heard(link, id, at)}
  end

  def heard(arbiter, _link, _id, _at), do: arbiter

  @doc """
  What clients want now (`Aerie.Fleet.Wants.merged/3`). `forwarded` is a message whose client's own request goes to the
  vehicle as it is: it counts as asked for.
  """
  @spec wants(t(), Aerie.Fleet.Wants.merged(), non_neg_integer() | nil) :: t()
  def wants(arbiter, merged, forwarded \\ nil) do
    arbiter = with_lines(%{arbiter | wants: merged.messages, groups: merged.groups})
    sent = Map.filter(arbiter.sent_groups, fn {group, _hz} -> is_map_key(merged.groups, group) end)
    forwarded(%{arbiter | sent_groups: sent}, forwarded)
  end

  defp forwarded(arbiter, id) when is_map_key(arbiter.lines, id) do
    line = arbiter.lines[id]
    queue = List.delete(arbiter.queue, {:set, id})
    line = Line.asked(line, line.hz || line.ask, Meter.last(arbiter.meter, id))
    put_line(%{arbiter | queue: queue}, %{line | state: :asked, tries: 1, next: nil})
  end

  defp forwarded(arbiter, _id), do: arbiter

  @doc "The vehicle's answer to a command of ours (MAV_CMD, MAV_RESULT)."
  @spec ack(t(), non_neg_integer(), non_neg_integer()) :: t()
  defdelegate ack(arbiter, command, result), to: Sender

  @doc "MESSAGE_INTERVAL: what the vehicle has set for a message (us)."
  @spec interval(t(), non_neg_integer(), integer(), integer()) :: t()
  defdelegate interval(arbiter, id, interval, at), to: Check

  @doc "The vehicle was restarted: its streams are what it begins with (R6)."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(arbiter, at) do
    fresh = %{new(arbiter.gateway) | wants: arbiter.wants, groups: arbiter.groups, begun: at + @grace_us}
    with_lines(fresh)
  end

  @doc "The vehicle is heard again after a silence: what is measured begins anew."
  @spec back(t(), integer()) :: t()
  def back(arbiter, at), do: resume(arbiter, at, arbiter.begun)

  @doc "Time goes on from `now`: what was heard counts as heard now."
  @spec rebased(t(), integer()) :: t()
  def rebased(arbiter, now) do
    once = Map.new(arbiter.once, fn {id, state} -> {id, with({tries, _next} <- state, do: {tries, nil})} end)
    lines = Map.new(arbiter.lines, fn {id, line} -> {id, %{line | resets: [], queries: []}} end)
    resume(%{arbiter | once: once, lines: lines, releases: %{}}, now, arbiter.begun && now + @grace_us)
  end

  defp resume(arbiter, now, begun) do
    lines = Map.new(arbiter.lines, fn {id, line} -> {id, %{line | next: nil}} end)

    %{
      arbiter
      | begun: begun,
        lines: lines,
        meter: Meter.restart(arbiter.meter, now),
        checked: nil,
        flight: nil
    }
  end

  @doc "What to send at `now` to a vehicle that is being heard, and what to tell; mostly nothing."
  @spec expire(t(), integer(), Request.target()) :: {t(), [struct()], [notice()]}
  def expire(%{begun: begun} = arbiter, now, _target) when begun == nil or now < begun, do: {arbiter, [], []}

  def expire(arbiter, now, target) do
    {arbiter, messages} = arbiter |> Check.run(now) |> Sender.run(now, target)
    {%{arbiter | notices: []}, messages, Enum.reverse(arbiter.notices)}
  end

  @doc "How far each wanted message has come (`Line.show/1`), by message id."
  @spec show(t()) :: %{non_neg_integer() => map()}
  def show(arbiter), do: Map.new(arbiter.lines, fn {id, line} -> {id, Line.show(line)} end)

  @doc false
  @spec put_line(t(), Line.t()) :: t()
  def put_line(arbiter, line), do: %{arbiter | lines: Map.put(arbiter.lines, line.id, line)}

  @doc false
  # Something to be sent, once however often it is asked for.
  @spec enqueue(t(), tuple()) :: t()
  def enqueue(arbiter, what),
    do: if(what in arbiter.queue, do: arbiter, else: %{arbiter | queue: arbiter.queue ++ [what]})

  # The lines follow the wants.
  defp with_lines(arbiter) do
    wanted = Map.merge(arbiter.gateway, arbiter.wants, fn _id, a, b -> max(a, b) end)
    ids = Map.keys(Map.merge(@floor, wanted))
    gone = Map.drop(arbiter.lines, ids)
    arbiter = Enum.reduce(gone, arbiter, fn {_id, line}, arbiter -> drop(arbiter, line) end)
    Enum.reduce(ids, arbiter, &follow(&2, &1, wanted[&1]))
  end

  defp drop(arbiter, line) do
    arbiter = %{
      arbiter
      | lines: Map.delete(arbiter.lines, line.id),
        meter: Meter.ignore(arbiter.meter, line.id),
        queue: arbiter.queue -- [{:set, line.id}, {:query, line.id}]
    }

    if line.set, do: release(arbiter, line.id), else: arbiter
  end

  defp follow(arbiter, id, hz) do
    ask = max(hz || 0, Map.get(@floor, id, 0))

    case arbiter.lines do
      %{^id => %{hz: ^hz}} ->
        arbiter

      %{^id => line} when hz != nil and (line.hz == nil or hz > line.hz) ->
        put_line(arbiter, %{line | hz: hz, ask: ask, state: :new, tries: 0, resets: [], next: nil})

      %{^id => line} ->
        arbiter = put_line(arbiter, %{line | hz: hz, ask: ask})
        if line.set, do: release(arbiter, id), else: arbiter

      _no_line ->
        put_line(%{arbiter | releases: Map.delete(arbiter.releases, id)}, %Line{id: id, hz: hz, ask: ask})
    end
  end

  defp release(arbiter, id), do: %{arbiter | releases: Map.put(arbiter.releases, id, nil)}
end
