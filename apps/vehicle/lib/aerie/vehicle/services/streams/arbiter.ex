defmodule Aerie.Vehicle.Services.Streams.Arbiter do
  @moduledoc """
  Decides which message rates to request of a vehicle, so that every client gets what it wants and other ground stations are
  not fought. A pure value.

  The gateway wants some messages at any rate (`floor/0`) and those of `mavlink.streams` at the configured rate; clients want
  what they requested. The highest rate of each message counts, because a rate belongs to the link and not to the client
  (M2).

  A message that comes as wanted is not requested. Any other is requested with SET_MESSAGE_INTERVAL, one command at a time,
  and then measured: an acknowledgement proves nothing (M2). There are three tries with growing pauses. A vehicle that does
  not know the command, or does not obey it, gets REQUEST_DATA_STREAM. After that nothing is sent until the vehicle reboots
  (R6) or the demand changes (M3).

  When no client wants a message any more, its rate is reset: to what was measured before the first request, otherwise to the
  vehicle's default. The same goes for the groups that clients request with REQUEST_DATA_STREAM (`Groups`).

  If a message that came as requested becomes too slow, its interval was changed by another program, or the link is too slow.
  The vehicle is asked for the interval (MESSAGE_INTERVAL). If it is ours, the link is too slow, and a request would not help.
  Otherwise the message is requested once more; when it is changed again within two minutes, it is left to the other
  program, and reported. Without an answer nothing is reported, because a link that loses data looks the same. The same
  goes for a message that comes too fast.

  Each function takes the time (us) as `now` or `at`. `Check` judges, `Sender` sends, `Groups` knows REQUEST_DATA_STREAM.
  """

  alias Aerie.Vehicle.Services.Streams.{Meter, Request, WantedMessage}
  alias Aerie.Vehicle.Services.Streams.Arbiter.{Check, Groups, Sender}
  alias MavCodec.Messages, as: M

  # The rates to request of messages that do not come by themselves.
  @floor %{
    M.ExtendedSysState.id() => 2,
    M.GlobalPositionInt.id() => 4,
    M.Attitude.id() => 4,
    M.VfrHud.id() => 2,
    M.SysStatus.id() => 1,
    M.GpsRawInt.id() => 1,
    M.BatteryStatus.id() => 0.5,
    M.MissionCurrent.id() => 1,
    M.RcChannels.id() => 1
  }
  # Requested once. HOME_POSITION comes by itself when it changes.
  @once [M.AutopilotVersion.id(), M.HomePosition.id()]

  @grace_us 2_000_000
  @late_us 2_000_000

  defstruct messages: %{},
            meter: Meter.new(),
            gateway: %{},
            demand: %{},
            groups: %{},
            sent_groups: %{},
            before: %{},
            once: %{},
            resets: %{},
            starts_at: nil,
            checked_at: nil,
            queue: [],
            in_flight: nil,
            held: false,
            accepted: false,
            obeyed: false,
            legacy: false,
            notices: []

  @typedoc """
  - `messages`: the wanted ones; `gateway`, `demand`: the rates that the gateway and clients want; all by message id
  - `groups`, `sent_groups`: rates of REQUEST_DATA_STREAM groups that clients want, and those that were requested for them
  - `before`: group => the rate of its members that nobody wants, before its first request; `:measuring` until it is known
  - `once`: id => `{tries, next}`, or `:known`
  - `resets`: id or `{:group, group}` => when the rate of what is not wanted any more is reset
  - `queue`, `in_flight`: what is to be sent, what waits for its acknowledgement
  - `held`: nothing is to be sent
  - `accepted`, `obeyed`: whether SET_MESSAGE_INTERVAL was ever acknowledged, whether a rate ever followed it
  - `legacy`: whether REQUEST_DATA_STREAM is used instead
  """
  @type t :: %__MODULE__{}

  @typedoc "Another program changed a rate. `yielded`: it is left to that program."
  @type notice :: %{
          id: non_neg_integer(),
          asked: number(),
          measured: number() | nil,
          how: :slower | :faster,
          yielded: boolean()
        }

  @doc "The messages that the gateway wants at any rate, with the rate that it requests."
  @spec floor() :: %{non_neg_integer() => number()}
  def floor, do: @floor

  @doc "Nothing heard yet. `gateway`: the rates (1/s) that the gateway itself wants, by message id."
  @spec new(%{non_neg_integer() => number()}) :: t()
  def new(gateway \\ %{}), do: update_messages(%__MODULE__{gateway: gateway, once: once()})

  defp once, do: Map.new(@once, &{&1, {0, nil}})

  @doc "Requests a message once, unless it has come already."
  @spec once(t(), non_neg_integer()) :: t()
  def once(arbiter, id), do: %{arbiter | once: Map.put_new(arbiter.once, id, {0, nil})}

  @doc "Requests a message once, although it has come before."
  @spec again(t(), non_neg_integer()) :: t()
  def again(arbiter, id), do: %{arbiter | once: Map.put(arbiter.once, id, {0, nil})}

  @doc "Nothing more is sent, or it is again."
  @spec hold(t(), boolean()) :: t()
  def hold(arbiter, held?), do: %{arbiter | held: held?}

  @doc "Whether nothing is sent, and no acknowledgement to what was sent before can come any more."
  @spec held?(t(), integer() | nil) :: boolean()
  def held?(%{held: true, in_flight: {_what, sent}}, now), do: now - sent >= @late_us
  def held?(arbiter, _now), do: arbiter.held

  @doc "A message of the autopilot came by a link."
  @spec received(t(), term(), non_neg_integer(), integer()) :: t()
  def received(%{starts_at: nil} = arbiter, link, id, at),
    do: received(%{arbiter | starts_at: at + @grace_us}, link, id, at)

  def received(%{once: once} = arbiter, _link, id, _at) when is_map_key(once, id),
    do: %{arbiter | once: Map.put(arbiter.once, id, :known)}

  def received(%{messages: messages} = arbiter, link, id, at) when is_map_key(messages, id) do
    %{arbiter | meter: arbiter.meter |> Meter.ensure(id, at) |> Meter.received(link, id, at)}
  end

  # Watched as a member of a group.
  def received(%{meter: %{watched: watched}} = arbiter, link, id, at) when is_map_key(watched, id),
    do: %{arbiter | meter: Meter.received(arbiter.meter, link, id, at)}

  def received(arbiter, _link, _id, _at), do: arbiter

  @doc """
  What clients want now (`Aerie.Vehicle.Services.StreamDemand.merged/3`). `forwarded`: the client's own request for this message is
  forwarded to the vehicle, so it counts as requested.
  """
  @spec demand(t(), Aerie.Vehicle.Services.StreamDemand.merged(), non_neg_integer() | nil) :: t()
  def demand(arbiter, merged, forwarded \\ nil) do
    update_messages(%{arbiter | demand: merged.messages})
    |> Groups.demand(merged.groups)
    |> forwarded(forwarded)
  end

  defp forwarded(arbiter, id) when is_map_key(arbiter.messages, id) do
    wanted = arbiter.messages[id]
    queue = List.delete(arbiter.queue, {:set, id})
    wanted = WantedMessage.asked(wanted, wanted.hz || wanted.ask, Meter.last(arbiter.meter, id))
    put(%{arbiter | queue: queue}, %{wanted | state: :asked, tries: 1, next: nil})
  end

  defp forwarded(arbiter, _id), do: arbiter

  @doc "The vehicle's COMMAND_ACK for one of our commands (MAV_CMD, MAV_RESULT)."
  @spec ack(t(), non_neg_integer(), non_neg_integer()) :: t()
  defdelegate ack(arbiter, command, result), to: Sender

  @doc "MESSAGE_INTERVAL: the interval (us) that the vehicle has set for a message."
  @spec interval(t(), non_neg_integer(), integer(), integer()) :: t()
  defdelegate interval(arbiter, id, interval, at), to: Check

  @doc "The vehicle was restarted, so its streams have their initial rates (R6)."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(arbiter, at) do
    update_messages(%{
      new(arbiter.gateway)
      | demand: arbiter.demand,
        groups: arbiter.groups,
        held: arbiter.held,
        starts_at: at + @grace_us
    })
  end

  @doc "The vehicle is heard again after a silence: measuring begins again."
  @spec back(t(), integer()) :: t()
  def back(arbiter, at), do: resume(arbiter, at, arbiter.starts_at)

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(t(), integer()) :: t()
  def rebased(arbiter, now) do
    once = Map.new(arbiter.once, fn {id, state} -> {id, with({tries, _next} <- state, do: {tries, nil})} end)
    messages = Map.new(arbiter.messages, fn {id, one} -> {id, %{one | changes: [], queries: []}} end)
    starts_at = arbiter.starts_at && now + @grace_us
    resets = Map.new(arbiter.resets, fn {what, _due} -> {what, nil} end)
    resume(%{arbiter | once: once, messages: messages, resets: resets}, now, starts_at)
  end

  defp resume(arbiter, now, starts_at) do
    messages = Map.new(arbiter.messages, fn {id, wanted} -> {id, %{wanted | next: nil}} end)

    %{
      arbiter
      | starts_at: starts_at,
        messages: messages,
        meter: Meter.restart(arbiter.meter, now),
        checked_at: nil,
        in_flight: nil
    }
  end

  @doc "The messages and reports due at `now` for a vehicle that is heard; mostly none."
  @spec expire(t(), integer(), Request.target()) :: {t(), [struct()], [notice()]}
  def expire(%{starts_at: starts_at} = arbiter, now, _target) when starts_at == nil or now < starts_at,
    do: {arbiter, [], []}

  def expire(arbiter, now, target) do
    {arbiter, messages} = arbiter |> Check.run(now) |> Sender.run(now, target)
    {%{arbiter | notices: []}, messages, Enum.reverse(arbiter.notices)}
  end

  @doc "The state of each wanted message (`WantedMessage.show/1`), by message id."
  @spec show(t()) :: %{non_neg_integer() => map()}
  def show(arbiter), do: Map.new(arbiter.messages, fn {id, wanted} -> {id, WantedMessage.show(wanted)} end)

  @doc false
  @spec put(t(), WantedMessage.t()) :: t()
  def put(arbiter, wanted), do: %{arbiter | messages: Map.put(arbiter.messages, wanted.id, wanted)}

  @doc false
  # Queues something to be sent, once however often it is queued.
  @spec enqueue(t(), tuple()) :: t()
  def enqueue(arbiter, what),
    do: if(what in arbiter.queue, do: arbiter, else: %{arbiter | queue: arbiter.queue ++ [what]})

  @doc false
  # A request that sets a message to this rate goes out now.
  @spec sent(t(), WantedMessage.t(), number(), integer()) :: t()
  def sent(arbiter, wanted, hz, now) do
    state = if wanted.state == :ok, do: :ok, else: :asked
    tries = max(wanted.tries, 1)
    wanted = WantedMessage.asked(wanted, hz, Meter.last(arbiter.meter, wanted.id))
    wanted = %{wanted | state: state, tries: tries, faster: false}

    put(
      %{arbiter | meter: Meter.watch(arbiter.meter, wanted.id, now)},
      %{wanted | next: now + WantedMessage.wait(wanted)}
    )
  end

  # Makes `messages` follow the demand.
  defp update_messages(arbiter) do
    rates = Map.merge(arbiter.gateway, arbiter.demand, fn _id, a, b -> max(a, b) end)
    ids = Map.keys(Map.merge(@floor, rates))
    unwanted = Map.drop(arbiter.messages, ids)
    arbiter = Enum.reduce(unwanted, arbiter, fn {_id, message}, arbiter -> drop(arbiter, message) end)
    Enum.reduce(ids, arbiter, &update(&2, &1, rates[&1]))
  end

  defp drop(arbiter, %{id: id, set: set}) do
    arbiter = %{
      arbiter
      | messages: Map.delete(arbiter.messages, id),
        meter: Meter.ignore(arbiter.meter, id),
        queue: arbiter.queue -- [{:set, id}, {:query, id}]
    }

    if set, do: reset(arbiter, id), else: arbiter
  end

  defp update(arbiter, id, hz) do
    ask = max(hz || 0, Map.get(@floor, id, 0))

    case arbiter.messages do
      %{^id => %{hz: ^hz}} ->
        arbiter

      %{^id => wanted} when hz != nil and (wanted.hz == nil or hz > wanted.hz) ->
        put(arbiter, %{wanted | hz: hz, ask: ask, state: :new, tries: 0, changes: [], next: nil})

      %{^id => wanted} ->
        arbiter = put(arbiter, %{wanted | hz: hz, ask: ask})
        if wanted.set, do: reset(arbiter, id), else: arbiter

      _new ->
        put(
          %{arbiter | resets: Map.delete(arbiter.resets, id)},
          %WantedMessage{id: id, hz: hz, ask: ask}
        )
    end
  end

  defp reset(arbiter, id), do: %{arbiter | resets: Map.put(arbiter.resets, id, nil)}
end
