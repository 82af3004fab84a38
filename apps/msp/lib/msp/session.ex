defmodule Msp.Session do
  @listen_us 1_200_000
  @good_us 1_000_000

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
  | `{:frames, frames}` | MAVLink frames of the vehicle |
  | `{:client, id, bytes}`, `{:client, id, :full}` | to a program; there is no room for it |
  | `{:judge, id, message}` | whether a program may do what this MAVLink message would ask for |
  | `{:wake, at}` | a `:tick` then; the latest one counts |
  | `{:count, name, n}` | damage of the line: `:crc_errors` frames, `:resync_bytes` outside of frames |
  | `{:fail, text}` | what is there is not a vehicle that can be used: the line is to be closed |

  For #{@listen_us / 1_000_000} s it only listens: a port where MAVLink comes is never asked by MSP (Q3). Then it asks who is there (`Msp.Session.Identifying`), and
  polls a vehicle's state (`Msp.Polls`).
  """

  alias MavCodec.Sniff
  alias Msp.{Exchange, Polls}

  alias Msp.Session.{
    Asking,
    Clients,
    Commands,
    Identifying,
    Missions,
    Motors,
    Output,
    Params,
    Reports,
    Sticks,
    Tasks
  }

  @enforce_keys [:system, :parser]
  defstruct [
    :system,
    :parser,
    :identity,
    :uid,
    :type,
    :polls,
    :boot,
    :answered_at,
    :up_at,
    now: 0,
    phase: :closed,
    restarted: false,
    exchange: Exchange.new(),
    ids: [],
    readings: %{},
    identifying: %Identifying{},
    tasks: %Tasks{},
    reports: %Reports{},
    params: %Params{},
    missions: %Missions{},
    sticks: %Sticks{},
    motors: %Motors{},
    clients: %Clients{},
    output: nil
  ]

  @typedoc """
  Only its own module changes what a part of the session has: `identifying`, `tasks`, `reports`, `params`, `missions`, `sticks`,
  `motors`, `clients` (programs that speak MSP), `output`. Besides:

  - `system`: the MAVLink id that the vehicle has
  - `now`: when its last event was
  - `phase`: `:closed`, `:listening`, `:identifying`, `:up` since `up_at`
  - `boot`: when the vehicle's clock began; `answered_at`: when it last answered
  - `uid`: of the vehicle, which its identity has only while that is known; `ids`: its BOXIDS
  - `restarted`: whether it was told to restart, so that it is asked who it is from then on
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
          | {:frames, [MavCodec.Frame.t(), ...]}
          | {:client, pos_integer, binary | :full}
          | {:judge, pos_integer, struct}
          | {:wake, integer}
          | {:count, :crc_errors | :resync_bytes, pos_integer}
          | {:fail, String.t()}

  @doc "The session of a line that is not open yet; the vehicle has this MAVLink id."
  @spec new(system :: 1..254) :: t
  def new(system) do
    %__MODULE__{system: system, parser: MavCodec.Parser.new(), output: Output.new(system)}
  end

  @doc "One step."
  @spec handle(t, event, integer) :: {t, [action]}
  def handle(session, event, now), do: event(%{session | now: now}, event, now)

  defp event(%{system: system, clients: clients}, :opened, now) do
    listening = %Identifying{until: now + @listen_us}
    session = %{new(system) | now: now, phase: :listening, identifying: listening, clients: clients}
    {session, [{:wake, listening.until}]}
  end

  defp event(session, {:client, id, :up}, now),
    do:
      if(Clients.room?(session),
        do: session |> Clients.up(id, now) |> advance(now),
        else: {session, [{:client, id, :full}]}
      )

  defp event(session, {:client, id, :down}, now), do: session |> Clients.down(id, now) |> advance(now)
  defp event(session, {:client, id, bytes}, now), do: session |> Clients.bytes(id, bytes, now) |> advance(now)

  defp event(session, {:judged, id, allowed?}, now),
    do: session |> Clients.judged(id, allowed?, now) |> advance(now)

  defp event(session, :closing, _now),
    do: {%{session | phase: :closed}, Motors.closing(session) ++ Clients.closing(session)}

  defp event(%{phase: :closed} = session, _event, _now), do: {session, []}

  defp event(%{phase: :listening} = session, {:bytes, bytes}, _now) do
    session = Identifying.hear(session, bytes)

    case Sniff.classify(session.identifying.heard) do
      %{protocol: protocol} when protocol in [:mavlink1, :mavlink2] ->
        fail(session, "it speaks MAVLink: configure it without msp:")

      _other ->
        {session, [{:wake, session.identifying.until}]}
    end
  end

  defp event(%{phase: :listening, identifying: %{until: until}} = session, :tick, now) when now >= until,
    do: session |> Identifying.start() |> proceed(now)

  defp event(%{phase: :listening} = session, _event, _now),
    do: {session, [{:wake, session.identifying.until}]}

  defp event(session, {:bytes, bytes}, now) do
    session = if session.identity, do: session, else: Identifying.hear(session, bytes)
    {answers, exchange} = Exchange.push(session.exchange, bytes, now)
    {next, actions} = answered(%{session | exchange: exchange}, answers, now)
    {next, damage(Exchange.counters(session.exchange), Exchange.counters(exchange)) ++ actions}
  end

  defp event(session, {:mavlink, bytes}, now) do
    {frames, parser} = MavCodec.Parser.push(session.parser, bytes, now)
    frames |> Enum.reduce(%{session | parser: parser}, &Commands.frame(&2, &1, now)) |> proceed(now)
  end

  defp event(session, :tick, now) do
    with {:timeout, tag, answers, exchange} <- Exchange.expire(session.exchange, now),
         {:ok, session} <- timeout(%{session | exchange: exchange}, tag, now) do
      answered(session, answers, now)
    else
      :wait -> proceed(session, now)
      {:fail, text} -> fail(session, text)
    end
  end

  defp damage(before, now) do
    for {name, key} <- [crc_errors: :checksum, resync_bytes: :skipped],
        n = now[key] - before[key],
        n > 0,
        do: {:count, name, n}
  end

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
  defp answer(%{phase: :identifying}, {:unasked, %{direction: :request} = frame}, _now),
    do: {:fail, Identifying.asked_by(frame)}

  defp answer(session, {:unasked, _push}, _now), do: {:ok, session}

  # What somebody asked for was given up; a poll's is still good within a second.
  defp answer(%{phase: :up} = session, {:late, {:poll, _} = tag, %{direction: :reply} = frame, sent_at}, now)
       when now - sent_at <= @good_us,
       do: answer(session, {:reply, tag, frame}, now)

  defp answer(session, {:late, _tag, _frame, _sent_at}, now), do: {:ok, alive(session, now)}

  defp answer(session, {:refused, {:about, name}}, now), do: Identifying.known(session, name, %{}, now)

  defp answer(session, {:refused, {:poll, name}}, now),
    do: {:ok, alive(%{session | polls: Polls.refused(session.polls, name)}, now)}

  defp answer(session, {:refused, {:task, task}}, now),
    do: {:ok, session |> alive(now) |> Tasks.reply(task, :refused, now)}

  defp answer(session, {:reply, {:task, %{client: id} = task}, frame}, now) when id != nil,
    do: {:ok, session |> alive(now) |> Tasks.reply(task, {:frame, frame}, now)}

  # What is acknowledged has no payload; another one is damaged.
  defp answer(session, {:reply, {:task, task}, frame}, now) do
    answer = with {:error, _damaged} <- MavCodec.Msp.decode(frame, Identifying.target(session)), do: :refused
    {:ok, session |> alive(now) |> Tasks.reply(task, answer, now)}
  end

  defp answer(session, {:reply, {kind, name}, frame}, now) do
    case {kind, MavCodec.Msp.decode(frame, Identifying.target(session))} do
      {:about, {:ok, values}} -> Identifying.known(session, name, values, now)
      {:about, {:error, _damaged}} -> Identifying.known(session, name, %{}, now)
      {:poll, {:ok, values}} -> {:ok, session |> alive(now) |> Reports.polled(name, values, now)}
      {:poll, {:error, _damaged}} -> {:ok, session}
    end
  end

  defp timeout(session, {:task, task}, now), do: {:ok, Tasks.reply(session, task, :timeout, now)}
  defp timeout(session, question, now), do: Identifying.timeout(session, question, now)

  defp alive(session, now), do: %{session | answered_at: now}

  defp fail(session, text) do
    {_unsent, session} = Output.take(session)
    {%{session | phase: :closed}, [{:fail, text}]}
  end

  # Nothing is asked before it is known who is there.
  defp advance(%{phase: phase} = session, now) when phase in [:identifying, :up], do: proceed(session, now)

  defp advance(session, _now) do
    {told, session} = Clients.take(session)
    {session, told}
  end

  # After each event: the next request, what is to be reported, and when to look again.
  defp proceed(session, now) do
    session = if session.restarted, do: Identifying.restarted(session, now), else: session
    {session, stops} = Motors.due(session, now)
    {session, channels} = session |> Missions.due(now) |> Sticks.due(now)
    {session, written} = Asking.next(session, now)
    {told, session} = Output.take(session)
    {programs, session} = Clients.take(session)
    {session, programs ++ stops ++ channels ++ written ++ told ++ [{:wake, Asking.wake(session, now)}]}
  end
end
