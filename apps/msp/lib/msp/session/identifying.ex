defmodule Msp.Session.Identifying do
  @tries 3
  @silent_us 1_000_000

  @moduledoc """
  Who is at the line: API_VERSION, FC_VARIANT and FC_VERSION, asked #{@tries} times at most, then what is needed once for each start. A vehicle that is silent
  for #{div(@silent_us, 1_000_000)} s is asked again: it may have been restarted, with other boxes, or be another one.
  """

  alias MavCodec.Msp.{Frame, Guard}
  alias MavCodec.Sniff
  alias Msp.{Exchange, Firmware, Identity, Polls, Session}
  alias Msp.Readings.Status
  alias Msp.Session.{Clients, Missions, Motors, Params, Reports, Sticks, Tasks}

  defstruct [:until, todo: [], tries: 0, found: %{}, heard: ""]

  @typedoc """
  - `until`: when the line was listened to for long enough
  - `todo`: messages still to be asked; `tries`: how often the first one was; `found`: their answers
  - `heard`: the last bytes before it was known who is there
  """
  @type t :: %__MODULE__{}

  @identify ["API_VERSION", "FC_VARIANT", "FC_VERSION"]
  @max_heard 4_096

  @type outcome :: {:ok, Session.t()} | {:fail, String.t()}

  @doc "Keeps what came before it is known who is there."
  @spec hear(Session.t(), binary) :: Session.t()
  def hear(session, bytes) do
    heard = session.identifying.heard <> bytes
    put_in(session.identifying.heard, binary_slice(heard, max(byte_size(heard) - @max_heard, 0)..-1//1))
  end

  @doc "Begins to ask."
  @spec start(Session.t()) :: Session.t()
  def start(session) do
    session = session |> Clients.interrupted() |> Missions.interrupted() |> Sticks.stop() |> Tasks.drop()

    %{
      session
      | phase: :identifying,
        identity: nil,
        exchange: Exchange.forget(session.exchange),
        identifying: %__MODULE__{todo: @identify}
    }
  end

  @doc "Begins to ask a vehicle that was told to restart."
  @spec restarted(Session.t(), integer) :: Session.t()
  def restarted(session, now), do: %{start(Params.stored(session)) | boot: now, restarted: false}

  @doc "By which firmware and version messages are read now."
  @spec target(Session.t()) :: Guard.target()
  def target(%{identity: nil}), do: Firmware.any()
  def target(%{identity: identity}), do: Identity.target(identity)

  @doc "What asks is at the line: why that cannot be a vehicle."
  @spec asked_by(Frame.t()) :: String.t()
  # Our own request as an echo, or the other end asks.
  def asked_by(%Frame{id: id}) when id in 1..3, do: "our own requests come back: the line is looped back"
  def asked_by(_frame), do: "it asks instead of answering: a video unit or another program is at this port"

  @doc "An answer to one of the questions; without values if it was refused."
  @spec known(Session.t(), String.t(), map, integer) :: outcome
  def known(session, name, values, now) do
    %{todo: todo, found: found} = session.identifying

    asked = %{
      session.identifying
      | todo: List.delete(todo, name),
        tries: 0,
        found: Map.put(found, name, values)
    }

    session = %{session | identifying: asked, answered_at: now}

    cond do
      asked.todo != [] -> {:ok, session}
      session.identity -> {:ok, session |> up(now) |> Motors.found() |> Params.ahead()}
      true -> recognise(session)
    end
  end

  defp recognise(%{identifying: %{found: found}} = session) do
    with %{"API_VERSION" => %{api_major: major, api_minor: minor}, "FC_VARIANT" => %{variant: variant}} <-
           found,
         {:ok, identity} <- Identity.of({major, minor}, variant, found["FC_VERSION"]) do
      # A vehicle may refuse any of it.
      {:ok, put_in(%{session | identity: identity}.identifying.todo, Firmware.of(identity.firmware).about)}
    else
      {:error, text} -> {:fail, text}
      _answers_missing -> {:fail, "it answers, but does not say which firmware it is"}
    end
  end

  defp up(%{identifying: %{found: found}} = session, now) do
    identity = %{
      session.identity
      | uid: uid(found["UID"]),
        name: Identity.printable(found["NAME"][:name] || "")
    }

    mixer = found["MIXER_CONFIG"][:mixer] || found["MSP2_INAV_MIXER"][:platform_type]

    session = if session.uid == identity.uid, do: session, else: Params.forget(session)

    %{
      Motors.forget(session)
      | phase: :up,
        up_at: now,
        identity: identity,
        uid: identity.uid,
        type: Status.type(identity.firmware, mixer),
        ids: Reports.ids(found["BOXIDS"]),
        polls: Polls.new(identity.firmware, now),
        boot: session.boot || now,
        # Whether it was restarted shows in what it says now and said then.
        readings: Map.take(session.readings, [:arming]),
        reports: %Reports{},
        identifying: %__MODULE__{}
    }
  end

  defp uid(%{id0: a, id1: b, id2: c}), do: Base.encode16(<<a::32, b::32, c::32>>, case: :lower)
  defp uid(_unknown), do: nil

  @doc "A question without an answer, or a poll."
  @spec timeout(Session.t(), {:about | :poll, String.t()}, integer) :: outcome
  def timeout(%{identifying: %{tries: tries}} = session, {:about, name}, now) do
    cond do
      tries + 1 < @tries -> {:ok, put_in(session.identifying.tries, tries + 1)}
      name not in @identify -> known(session, name, %{}, now)
      # It was there: it is restarting, or its line is interrupted.
      session.answered_at -> {:ok, put_in(session.identifying.tries, 0)}
      true -> {:fail, silent(session)}
    end
  end

  def timeout(%{answered_at: at} = session, {:poll, _name}, now) do
    # On a line whose replies take longer, some of them.
    patience = max(@silent_us, 3 * Exchange.timeout_us(session.exchange))
    {:ok, if(now - at > patience, do: start(session), else: session)}
  end

  defp silent(%{identifying: %{heard: ""}}), do: "it does not answer MSP"

  defp silent(%{identifying: %{heard: heard}}) do
    if String.contains?(heard, "$M<"),
      do:
        "its command line is open, as each request comes back as $M<: close it with exit or restart the vehicle, which cannot be armed until then",
      else: "it does not answer MSP, but sends #{Sniff.name(Sniff.classify(heard).protocol)}"
  end
end
