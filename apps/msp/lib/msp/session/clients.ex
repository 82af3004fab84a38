defmodule Msp.Session.Clients do
  @most_waiting 16
  @most_clients 8
  @silent_us 10_000_000

  @moduledoc """
  Programs that speak MSP themselves (configurators), and share one flight controller.

  Each of their frames is parsed, checked by `MavCodec.Msp.Guard` and rebuilt; what changes something is judged first (`Msp.Meaning`), and
  nothing that the table keeps from armed vehicles is sent to one. Each has one request under way, in turn with the others, before polls and after
  commands; #{@most_waiting} more wait, and beyond that the newest is refused. A refusal is the firmware's own: an error reply.

  What a program leaves behind is undone when it is gone: arming that it disabled is enabled, and motors that it turned are stopped, also
  #{div(@silent_us, 1_000_000)} s after it last spoke of them.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Msp.{Frame, Guard, Parser}
  alias Msp.{Firmware, Identity, Meaning, Session}
  alias Msp.Session.{Motors, Output, Tasks}
  alias Msp.Session.Tasks.Armed

  @arm 0
  @set_mode_range 35
  @arming_disabled 99
  @set_motor 214
  @reboot 68
  @notice 5
  # Writing the EEPROM takes up to two seconds, which these do: EEPROM_WRITE, missions and profiles of iNav, RESET_CONF.
  # A restart and reading the flash take their time as well.
  @slow_us 5_000_000
  @slow [250, 18, 19, 210, 0x2018, 0x2080, 208, 68, 71, 72]

  defstruct map: %{}, told: [], judgements: []

  @type id :: pos_integer
  @typedoc "The programs; `told`, `judgements`: what is to be said to them, and asked of the policy."
  @type t :: %__MODULE__{map: %{id => map}, told: [tuple], judgements: [tuple]}

  @doc "A program is there; one that was there by this number is gone."
  @spec up(Session.t(), id, integer) :: Session.t()
  def up(%{clients: %{map: map}} = session, id, now) when is_map_key(map, id),
    do: session |> down(id, now) |> up(id, now)

  def up(session, id, _now) do
    client = %{parser: Parser.new(), waiting: [], judged: nil, busy: false, disables: false, motors: false}
    put_in(session.clients.map[id], client)
  end

  @doc "Whether there is room for one more."
  @spec room?(Session.t()) :: boolean
  def room?(%{clients: %{map: map}}), do: map_size(map) < @most_clients

  @doc "A program is gone: what it left behind is undone."
  @spec down(Session.t(), id, integer) :: Session.t()
  def down(session, id, now) do
    case pop_in(session.clients.map[id]) do
      {nil, session} ->
        session

      {client, session} ->
        session = Tasks.drop(session, &(&1[:client] == id))
        session = if client.motors, do: Motors.until(session, now), else: session

        if client.disables and not wants_disarmed?(session),
          do: enable(session),
          else: session
    end
  end

  @doc """
  The vehicle says that MSP keeps it from being armed. Nothing enables it again but the port that disabled it, or a restart: so this one
  does, unless a program wants it.
  """
  @spec disabled(Session.t(), boolean) :: Session.t()
  def disabled(session, true) do
    if wants_disarmed?(session), do: session, else: enable(session)
  end

  def disabled(session, false), do: session

  defp enable(session) do
    session
    |> Output.text(@notice, "A program that had disabled arming is gone: it is enabled again")
    |> Tasks.add(%{kind: __MODULE__, client: nil, tries: 0, ask: enabling()})
  end

  defp enabling, do: {"SET_ARMING_DISABLED", %{disabled: 0, runaway_disabled: 0}}

  @doc "What is written before the line is closed."
  @spec closing(Session.t()) :: [{:write, binary}]
  def closing(%{phase: :up} = session) do
    {name, values} = enabling()

    with true <- wants_disarmed?(session),
         {:ok, frame} <- MavCodec.Msp.request(Identity.target(session.identity), name, values) do
      [{:write, IO.iodata_to_binary(Frame.encode(frame))}]
    else
      _none -> []
    end
  end

  def closing(_session), do: []

  @doc "Bytes of a program."
  @spec bytes(Session.t(), id, binary, integer) :: Session.t()
  def bytes(%{clients: %{map: map}} = session, id, bytes, now) when is_map_key(map, id) do
    {frames, parser} = Parser.push(map[id].parser, bytes)
    session = update(session, id, &%{&1 | parser: parser})
    requests = for %{direction: :request} = frame <- frames, do: frame
    requests |> Enum.reduce(session, &wait(&2, id, &1)) |> next(id, now)
  end

  def bytes(session, _id, _bytes, _now), do: session

  defp wait(session, id, frame) do
    if length(session.clients.map[id].waiting) >= @most_waiting,
      do: refuse(session, id, frame),
      else: update(session, id, &%{&1 | waiting: &1.waiting ++ [frame]})
  end

  # One request of each is under way.
  defp next(session, id, now) do
    case session.clients.map do
      %{^id => %{busy: false, waiting: [frame | rest]}} ->
        session |> update(id, &%{&1 | waiting: rest, busy: true}) |> begin(id, frame, now)

      _nothing ->
        session
    end
  end

  defp begin(%{phase: :up} = session, id, frame, now) do
    target = Identity.target(session.identity)

    with {:ok, message} <- Guard.check(frame, target),
         :ok <- allowed(session, message, frame) do
      if Meaning.reads?(message, frame),
        do: ask(session, id, frame),
        else: judge(session, id, frame, Meaning.of(target, message, frame, session.system))
    else
      {:error, why} ->
        session |> Output.text(@notice, "Program #{id}: #{why}") |> over(id, frame, :refused, now)
    end
  end

  # As a flight controller that does not answer yet.
  defp begin(session, id, _frame, now), do: session |> update(id, &%{&1 | busy: false}) |> next(id, now)

  defp allowed(_session, %{channels?: true, name: name}, _frame),
    do: {:error, "#{name} is not for programs: arm and manual_control send channels, with a dead-man"}

  # What stops a motor that turns both ways is another value, so it could not be stopped for a program that is gone.
  defp allowed(%{motors: %{one_way: one_way}}, _message, %{id: @set_motor}) when one_way != true,
    do: {:error, "SET_MOTOR refused: its motors turn both ways, or it has not said yet that they do not"}

  # Betaflight's last byte links it to another mode.
  defp allowed(session, message, %{id: @set_mode_range, payload: <<_slot, @arm, aux, range::binary>>} = frame) do
    if wants_disarmed?(session) or not arms?(range, Enum.at(session.readings[:channels] || [], aux + 4)),
      do: disarmed(session, message, frame),
      else:
        {:error, "SET_MODE_RANGE refused: its switch is there already, or is not known, so that it would arm"}
  end

  defp allowed(session, message, frame), do: disarmed(session, message, frame)

  defp arms?(<<_first, _last, _logic, linked, _::binary>>, _us) when linked != 0, do: true
  defp arms?(<<first, last, _::binary>>, _us) when first >= last, do: false
  defp arms?(_range, nil), do: true
  defp arms?(<<first, last, _::binary>>, us), do: us >= 900 + 25 * first and us < 900 + 25 * last

  defp wants_disarmed?(session), do: Enum.any?(session.clients.map, fn {_id, client} -> client.disables end)

  defp disarmed(session, message, frame) do
    if Armed.only_disarmed?(message, frame) and Armed.early(session) != nil,
      do: {:error, "#{message.name} refused: #{Armed.early(session)}"},
      else: :ok
  end

  # The caller asks the policy and answers with `judged/4`.
  defp judge(session, id, frame, meaning) do
    session = update(session, id, &%{&1 | judged: frame})
    update_in(session.clients.judgements, &(&1 ++ [{:judge, id, meaning}]))
  end

  @doc "What the policy says of the request that was to be judged."
  @spec judged(Session.t(), id, boolean, integer) :: Session.t()
  def judged(session, id, allowed?, now) do
    case session.clients.map do
      %{^id => %{judged: frame}} when frame != nil ->
        session = update(session, id, &%{&1 | judged: nil})
        if allowed?, do: write(session, id, frame, now), else: over(session, id, frame, :refused, now)

      _gone ->
        session
    end
  end

  # Others may still want it disabled.
  defp write(session, id, %{id: @arming_disabled, payload: <<disable, _::binary>>} = frame, now) do
    before = wants_disarmed?(session)
    session = update(session, id, &%{&1 | disables: disable != 0})
    wanted = wants_disarmed?(session)

    if before and wanted, do: over(session, id, frame, {:reply, ""}, now), else: ask(session, id, frame)
  end

  defp write(session, id, %{id: @set_motor, payload: payload} = frame, now) do
    turning? = Motors.turn?(session, for(<<us::16-little <- payload>>, do: us))
    session = update(session, id, &%{&1 | motors: turning?})
    session |> Motors.until(if(turning?, do: now + @silent_us, else: now)) |> ask(id, frame)
  end

  defp write(session, id, frame, _now), do: ask(session, id, frame)

  defp ask(session, id, frame) do
    # Rebuilt: with our own flags, and in the form that its id needs.
    built = %Frame{form: if(frame.id > 254, do: :v2, else: :v1), id: frame.id, payload: frame.payload}
    patience = if frame.id in @slow, do: @slow_us, else: 0
    Tasks.add(session, %{kind: __MODULE__, client: id, frame: frame, ask: {built, patience}})
  end

  @impl Tasks
  # The session's own task.
  def answer(session, %{client: nil, tries: tries} = task, :timeout, _now) when tries < 5,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{client: nil} = task, _answer, _now), do: Tasks.done(session, task)

  def answer(session, %{client: id, frame: frame} = task, answer, now) do
    session = Tasks.done(session, task)

    case answer do
      {:frame, %{direction: :error}} ->
        over(session, id, frame, :refused, now)

      {:frame, %{payload: payload}} ->
        session |> over(id, frame, {:reply, payload}, now) |> followed(frame)

      :refused ->
        over(session, id, frame, :refused, now)

      {kind, why} when kind in [:denied, :unfit] ->
        session |> Output.text(@notice, "Program #{id}: #{why}") |> over(id, frame, :refused, now)

      # It asks again by itself.
      :timeout ->
        over(session, id, frame, :silent, now)
    end
  end

  defp followed(session, %{id: @reboot}), do: %{session | restarted: true}
  defp followed(session, _frame), do: session

  defp over(session, id, frame, outcome, now) do
    session =
      case outcome do
        :refused -> refuse(session, id, frame)
        {:reply, payload} -> tell(session, id, %{frame | direction: :reply, payload: payload})
        :silent -> session
      end

    if is_map_key(session.clients.map, id),
      do: session |> update(id, &%{&1 | busy: false}) |> next(id, now),
      else: session
  end

  defp refuse(session, id, frame),
    do: tell(session, id, %{frame | direction: :error, payload: ""})

  # Flags stay: programs number their requests by them. With the lowest one some firmware answers none.
  defp tell(session, id, frame) do
    if rem(frame.flags, 2) == 1 and session.identity != nil and
         Firmware.of(session.identity.firmware).quiet_flag?,
       do: session,
       else: update_in(session.clients.told, &[{:client, id, Frame.encode(frame)} | &1])
  end

  defp update(session, id, fun), do: update_in(session.clients.map, &Map.replace_lazy(&1, id, fun))

  @doc "The answers for programs, and what is to be judged, since the last call."
  @spec take(Session.t()) :: {[Session.action()], Session.t()}
  def take(%{clients: %{told: [], judgements: []}} = session), do: {[], session}

  def take(%{clients: %{told: told, judgements: judgements} = clients} = session),
    do: {Enum.reverse(told) ++ judgements, %{session | clients: %{clients | told: [], judgements: []}}}

  @doc "The vehicle is asked again who it is: what was under way has no answer."
  @spec interrupted(Session.t()) :: Session.t()
  def interrupted(session) do
    idle = %{busy: false, judged: nil, waiting: [], disables: false}
    update_in(session.clients.map, &Map.new(&1, fn {id, client} -> {id, Map.merge(client, idle)} end))
  end
end
