defmodule Msp.Session do
  @listen_us 1_200_000
  @tries 3
  @silent_us 1_000_000

  @moduledoc """
  One flight controller that speaks MSP, as an autopilot that speaks MAVLink: `handle(session, event, now) -> {session, actions}`. Time is in
  microseconds of a clock that is never set.

  | event | |
  |---|---|
  | `:opened` | the line is there |
  | `{:bytes, bytes}` | from the flight controller |
  | `{:mavlink, bytes}` | frames from clients and from the gateway itself, for this vehicle or for all |
  | `:tick` | the time that an action asked for has come |
  | `{:client, id, :up}`, `{:client, id, :down}`, `{:client, id, bytes}` | a program that speaks MSP itself |
  | `{:judged, id, boolean}` | whether the policy lets it do what was to be judged |
  | `:closing` | the line is about to be closed |

  | action | |
  |---|---|
  | `{:write, bytes}` | to the flight controller |
  | `{:mavlink, bytes}` | frames of the vehicle |
  | `{:client, id, bytes}`, `{:client, id, :full}` | to a program; there is no room for it |
  | `{:judge, id, message}` | whether a program may do what this MAVLink message would ask for |
  | `{:wake, at}` | a `:tick` then; the latest one counts |
  | `{:count, name, n}` | damage of the line: `:crc_errors` frames, `:resync_bytes` outside of frames |
  | `{:fail, text}` | what is there is not a vehicle that can be used: the line is to be closed |

  For #{@listen_us / 1_000_000} s it only listens: a port where MAVLink comes is never asked by MSP (Q3). Then it asks who is there, #{@tries} times at most,
  and polls a vehicle's state (`Msp.Polls`). A vehicle that is silent for #{div(@silent_us, 1_000_000)} s is asked again who it is: it may
  have been restarted, with other boxes, or be another one.
  """

  alias MavCodec.{Encoder, Sniff}
  alias MavCodec.Msp.Frame
  alias Msp.{Exchange, Identity, Polls, Telemetry}
  alias Msp.Session.{Clients, Commands, Missions, Motors, Output, Params, Reports, Sticks, Tasks}

  @identify ["API_VERSION", "FC_VARIANT", "FC_VERSION"]
  # What is needed once for each start; a vehicle may refuse any of it.
  @about %{
    betaflight: ["UID", "NAME", "BOXIDS", "MIXER_CONFIG"],
    inav: ["UID", "NAME", "BOXIDS", "MSP2_INAV_MIXER"]
  }
  # As long as it is not known who is there: what is asked then is the same in all firmware.
  @nobody {:betaflight, nil}
  @max_heard 4_096
  @again_us 10_000

  @enforce_keys [:system, :encoder, :parser]
  defstruct [
    :system,
    :encoder,
    :parser,
    :until,
    :identity,
    :type,
    :polls,
    :boot,
    :heartbeat,
    :complaint,
    :answered_at,
    :params,
    :uid,
    :mission,
    :upload,
    :uploaded,
    :receiver,
    :motors,
    :one_way,
    :ignored_at,
    :up_at,
    phase: :closed,
    exchange: Exchange.new(),
    todo: [],
    tries: 0,
    found: %{},
    heard: "",
    ids: [],
    readings: %{},
    tasks: [],
    texts: 0,
    serial: 0,
    unsaved: false,
    clients: %{},
    told: [],
    judgements: [],
    outbox: []
  ]

  @typedoc """
  - `system`: the MAVLink id that the vehicle has
  - `phase`: `:closed`, `:listening` until `until`, `:identifying`, `:up` since `up_at`
  - `todo`: messages still to be asked; `found`: their answers; `heard`: the last bytes before it was known who is there
  - `boot`: when the vehicle's clock began; `heartbeat`: the last one, and when it was sent
  - `complaint`: the names of the last text about what keeps it from being armed
  - `uid`: of the vehicle, which its identity has only while that is known
  - `params`: the names of its parameters in their order, nil until they were read; `unsaved`: some were set and not stored
  - `mission`: the waypoints and items of the mission aboard, nil until they were read; `upload`: the one that a client writes; `uploaded`: who
    wrote the last one, and what came of it
  - `receiver`: the channels that are sent in place of a transmitter's, nil for none
  - `motors`: when those of a test are stopped, and how often they were told to; nil while none turns
  - `one_way`: whether its motors turn one way only, so that 1000 us stops them; nil until it has said so
  - `ignored_at`: when a text last said that sticks were ignored
  - `clients`: programs that speak MSP themselves; `told`, `judgements`: what is to be said to them, and asked of the policy
  - `tasks`: what clients asked for that needs the flight controller
  """
  @type t :: %__MODULE__{}
  @type event ::
          :opened
          | {:bytes, binary}
          | {:mavlink, binary}
          | {:client, pos_integer, :up | :down | binary}
          | {:judged, pos_integer, boolean}
          | :tick
          | :closing
  @type action ::
          {:write, binary}
          | {:mavlink, binary}
          | {:client, pos_integer, binary | :full}
          | {:judge, pos_integer, struct}
          | {:wake, integer}
          | {:count, :crc_errors | :resync_bytes, pos_integer}
          | {:fail, String.t()}

  @doc "The session of a line that is not open yet; the vehicle has this MAVLink id."
  @spec new(system :: 1..254) :: t
  def new(system) do
    %__MODULE__{
      system: system,
      encoder: Encoder.new(system: system, component: 1),
      parser: MavCodec.Parser.new()
    }
  end

  @doc "One step."
  @spec handle(t, event, integer) :: {t, [action]}
  def handle(%{system: system, clients: clients}, :opened, now),
    do:
      {%{new(system) | phase: :listening, until: now + @listen_us, clients: clients},
       [{:wake, now + @listen_us}]}

  def handle(session, {:client, id, :up}, _now),
    do: if(Clients.room?(session), do: {Clients.up(session, id), []}, else: {session, [{:client, id, :full}]})

  def handle(session, {:client, id, :down}, now), do: session |> Clients.down(id, now) |> advance(now)
  def handle(session, {:client, id, bytes}, now), do: session |> Clients.bytes(id, bytes, now) |> advance(now)

  def handle(session, {:judged, id, allowed?}, now),
    do: session |> Clients.judged(id, allowed?, now) |> advance(now)

  def handle(session, :closing, _now),
    do: {%{session | phase: :closed}, Motors.closing(session) ++ Clients.closing(session)}

  def handle(%{phase: :closed} = session, _event, _now), do: {session, []}

  def handle(%{phase: :listening} = session, {:bytes, bytes}, _now) do
    session = hear(session, bytes)

    case Sniff.classify(session.heard) do
      %{protocol: protocol} when protocol in [:mavlink1, :mavlink2] ->
        fail(session, "it speaks MAVLink: configure it without msp:")

      _other ->
        {session, [{:wake, session.until}]}
    end
  end

  def handle(%{phase: :listening, until: until} = session, :tick, now) when now >= until,
    do: session |> identify() |> proceed(now)

  def handle(%{phase: :listening} = session, _event, _now), do: {session, [{:wake, session.until}]}

  def handle(session, {:bytes, bytes}, now) do
    session = if session.identity, do: session, else: hear(session, bytes)
    {answers, exchange} = Exchange.push(session.exchange, bytes, now)
    {next, actions} = answered(%{session | exchange: exchange}, answers, now)
    {next, damage(Exchange.counters(session.exchange), Exchange.counters(exchange)) ++ actions}
  end

  def handle(session, {:mavlink, bytes}, now) do
    {frames, parser} = MavCodec.Parser.push(session.parser, bytes, now)
    frames |> Enum.reduce(%{session | parser: parser}, &Commands.frame(&2, &1, now)) |> proceed(now)
  end

  def handle(session, :tick, now) do
    with {:timeout, tag, answers, exchange} <- Exchange.expire(session.exchange, now),
         {:ok, session} <- timeout(%{session | exchange: exchange}, tag, now) do
      answered(session, answers, now)
    else
      :wait -> proceed(session, now)
      {:fail, text} -> fail(session, text)
    end
  end

  @doc false
  # For `Msp.Session.Commands`: the vehicle restarts.
  @spec restarting(t, integer) :: t
  def restarting(session, now), do: %{identify(session) | boot: now, unsaved: false}

  defp damage(before, now) do
    for {name, key} <- [crc_errors: :checksum, resync_bytes: :skipped],
        n = now[key] - before[key],
        n > 0,
        do: {:count, name, n}
  end

  defp hear(session, bytes) do
    heard = session.heard <> bytes
    %{session | heard: binary_slice(heard, max(byte_size(heard) - @max_heard, 0)..-1//1)}
  end

  defp identify(session),
    do: %{
      Clients.interrupted(session)
      | phase: :identifying,
        identity: nil,
        todo: @identify,
        tries: 0,
        found: %{},
        heard: "",
        tasks: [],
        mission: nil,
        upload: nil,
        receiver: nil
    }

  defp answered(session, answers, now) do
    answers
    |> Enum.reduce_while({:ok, session}, fn answer, {:ok, session} ->
      case answer(session, answer, now) do
        {:ok, session} -> {:cont, {:ok, session}}
        {:fail, text} -> {:halt, {:fail, text}}
      end
    end)
    |> case do
      {:ok, session} -> proceed(session, now)
      {:fail, text} -> fail(session, text)
    end
  end

  # What comes in before it is known who is there is for the diagnosis; later it is none of ours (DisplayPort).
  defp answer(%{phase: :identifying} = session, {:unasked, %{direction: :request} = frame}, _now),
    do: {:fail, asked_by(frame, session)}

  defp answer(session, {:unasked, _push}, _now), do: {:ok, session}

  defp answer(session, {:refused, {:about, name}}, now), do: known(session, name, %{}, now)

  defp answer(session, {:refused, {:poll, name}}, now),
    do: {:ok, alive(%{session | polls: Polls.refused(session.polls, name)}, now)}

  defp answer(session, {:refused, {:task, task}}, now),
    do: {:ok, session |> alive(now) |> Tasks.reply(task, :refused, now)}

  defp answer(session, {:reply, {:task, %{client: id} = task}, frame}, now) when id != nil,
    do: {:ok, session |> alive(now) |> Tasks.reply(task, {:frame, frame}, now)}

  # What is acknowledged has no payload; another one is damaged.
  defp answer(session, {:reply, {:task, task}, frame}, now) do
    answer = with {:error, _damaged} <- MavCodec.Msp.decode(frame, target(session)), do: :refused
    {:ok, session |> alive(now) |> Tasks.reply(task, answer, now)}
  end

  defp answer(session, {:reply, {kind, name}, frame}, now) do
    case {kind, MavCodec.Msp.decode(frame, target(session))} do
      {:about, {:ok, values}} -> known(session, name, values, now)
      {:about, {:error, _damaged}} -> known(session, name, %{}, now)
      {:poll, {:ok, values}} -> {:ok, session |> alive(now) |> Reports.polled(name, values, now)}
      {:poll, {:error, _damaged}} -> {:ok, session}
    end
  end

  defp alive(session, now), do: %{session | answered_at: now}

  # Our own request as an echo, or the other end asks.
  defp asked_by(%Frame{id: id}, _session) when id in 1..3,
    do: "our own requests come back: the line is looped back"

  defp asked_by(_frame, _session),
    do: "it asks instead of answering: a video unit or another program is at this port"

  defp target(%{identity: nil}), do: @nobody
  defp target(%{identity: identity}), do: Identity.target(identity)

  defp known(session, name, values, now) do
    session = %{
      session
      | todo: List.delete(session.todo, name),
        tries: 0,
        found: Map.put(session.found, name, values)
    }

    session = alive(session, now)

    cond do
      session.todo != [] -> {:ok, session}
      session.identity -> {:ok, session |> up(now) |> Motors.found() |> Params.ahead()}
      true -> recognise(session)
    end
  end

  defp recognise(%{found: found} = session) do
    with %{"API_VERSION" => %{api_major: major, api_minor: minor}, "FC_VARIANT" => %{variant: variant}} <-
           found,
         {:ok, identity} <- Identity.of({major, minor}, variant, found["FC_VERSION"]) do
      {:ok, %{session | identity: identity, todo: @about[identity.firmware]}}
    else
      {:error, text} -> {:fail, text}
      _answers_missing -> {:fail, "it answers, but does not say which firmware it is"}
    end
  end

  defp up(%{found: found} = session, now) do
    identity = %{
      session.identity
      | uid: uid(found["UID"]),
        name: Identity.printable(found["NAME"][:name] || "")
    }

    mixer = found["MIXER_CONFIG"][:mixer] || found["MSP2_INAV_MIXER"][:platform_type]

    %{
      session
      | phase: :up,
        up_at: now,
        one_way: nil,
        identity: identity,
        uid: identity.uid,
        # Of another vehicle they are others.
        params: if(session.uid == identity.uid, do: session.params),
        type: Telemetry.type(identity.firmware, mixer),
        ids: Reports.ids(found["BOXIDS"]),
        polls: Polls.new(identity.firmware, now),
        boot: session.boot || now,
        # Whether it was restarted shows in what it says now and said then.
        readings: Map.take(session.readings, [:arming]),
        heartbeat: nil,
        complaint: nil,
        heard: ""
    }
  end

  defp uid(%{id0: a, id1: b, id2: c}), do: Base.encode16(<<a::32, b::32, c::32>>, case: :lower)
  defp uid(_unknown), do: nil

  defp timeout(%{phase: :identifying, tries: tries} = session, {:about, name}, now) do
    cond do
      tries + 1 < @tries -> {:ok, %{session | tries: tries + 1}}
      name not in @identify -> known(session, name, %{}, now)
      # It was there: it is restarting, or its line is interrupted.
      session.answered_at -> {:ok, %{session | tries: 0}}
      true -> {:fail, silent(session)}
    end
  end

  defp timeout(session, {:task, task}, now), do: {:ok, Tasks.reply(session, task, :timeout, now)}

  defp timeout(%{answered_at: at} = session, _poll, now) when now - at > @silent_us,
    do: {:ok, identify(session)}

  defp timeout(session, _poll, _now), do: {:ok, session}

  defp silent(%{heard: ""}), do: "it does not answer MSP"

  defp silent(%{heard: heard}) do
    if String.contains?(heard, "$M<"),
      do:
        "its command line is open, as each request comes back as $M<: close it with exit or restart the vehicle, which cannot be armed until then",
      else: "it does not answer MSP, but sends #{Sniff.name(Sniff.classify(heard).protocol)}"
  end

  defp fail(session, text), do: {%{session | phase: :closed, outbox: []}, [{:fail, text}]}

  # Nothing is asked before it is known who is there.
  defp advance(%{phase: phase} = session, now) when phase in [:identifying, :up], do: proceed(session, now)

  defp advance(session, _now) do
    {told, session} = Clients.take(session)
    {session, told}
  end

  # After each event: the next request, what is to be told, and when to look again.
  defp proceed(session, now) do
    {session, stops} = Motors.due(session, now)
    {session, channels} = session |> Missions.due(now) |> Sticks.due(now)
    {session, written} = ask(session, now)
    {told, session} = Output.take(session)
    {programs, session} = Clients.take(session)
    {session, programs ++ stops ++ channels ++ written ++ told ++ [{:wake, wake(session, now)}]}
  end

  defp ask(%{exchange: %{asked: asked}} = session, _now) when asked != nil, do: {session, []}

  defp ask(%{phase: :identifying, todo: [name | more]} = session, now) do
    case MavCodec.Msp.request(target(session), name) do
      {:ok, frame} -> send_if_ready(session, {:about, name}, frame, now, 0)
      # This version does not have it.
      {:error, _why} -> ask(%{session | todo: more}, now)
    end
  end

  # What clients asked for, then what is due, then what takes long. Clients that ask without end do not silence the vehicle.
  defp ask(session, now) do
    case if(Polls.late?(session.polls, now), do: {:none, session}, else: first(session)) do
      {:none, session} -> poll(session, now)
      {{:ask, task, frame, patience}, session} -> send_if_ready(session, {:task, task}, frame, now, patience)
    end
  end

  defp first(session) do
    with {:none, session} <- Tasks.next(session, :urgent), do: Tasks.next(session, :program)
  end

  defp poll(session, now) do
    case Polls.next(session.polls, now) do
      {:ask, name, arguments} ->
        {:ok, frame} = MavCodec.Msp.request(target(session), name, arguments)
        {session, written} = send_if_ready(session, {:poll, name}, frame, now, 0)

        if written == [],
          do: {session, []},
          else: {%{session | polls: Polls.asked(session.polls, name, now)}, written}

      _nothing_due ->
        case Tasks.next(session, :bulk) do
          {:none, session} ->
            {session, []}

          {{:ask, task, frame, patience}, session} ->
            send_if_ready(session, {:task, task}, frame, now, patience)
        end
    end
  end

  defp send_if_ready(session, tag, frame, now, patience) do
    if Exchange.ready(session.exchange, frame, now) == :now do
      {bytes, exchange} = Exchange.send(session.exchange, tag, frame, now, patience)
      {%{session | exchange: exchange}, [{:write, bytes}]}
    else
      {session, []}
    end
  end

  defp wake(%{motors: %{due: due}} = session, now),
    do: min(max(due, now + @again_us), wake(%{session | motors: nil}, now))

  defp wake(%{receiver: %{due: due}} = session, now), do: min(due, wake(%{session | receiver: nil}, now))
  defp wake(%{exchange: %{deadline: deadline}}, _now) when deadline != nil, do: deadline

  defp wake(%{phase: :up, tasks: [], upload: nil} = session, now) do
    case Polls.next(session.polls, now) do
      {:at, at} -> at
      _due -> now + @again_us
    end
  end

  defp wake(_session, now), do: now + @again_us
end
