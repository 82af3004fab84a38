defmodule Msp.Session.Sticks do
  @moduledoc """
  Arming, modes and sticks over MSP, by the channels of `Msp.Receiver`: COMPONENT_ARM_DISARM, DO_SET_MODE, MANUAL_CONTROL, RC_CHANNELS_OVERRIDE.

  The first of them reads what the vehicle's receiver and switches are configured to be; its source is then the only one that steers, until
  the channels stop. They are sent beside the request that waits for its answer, because a lost answer must not stop them.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Frame
  alias Msp.{Firmware, Identity, Modes, Readings, Receiver, Session}
  alias Msp.Firmware.Arming
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Tasks.Armed

  defstruct [:receiver, :ignored_at, :asked_at, :unsure_until]

  @typedoc """
  - `receiver`: the channels that are sent in place of a transmitter's, nil for none
  - `ignored_at`: when a text last said that sticks were ignored; `asked_at`: when the vehicle was last asked whether
    they may take it over
  - `unsure_until`: until then that it misses no receiver does not show that somebody else sends channels
  """
  @type t :: %__MODULE__{}

  @manual M.ManualControl.id()
  @override M.RcChannelsOverride.id()
  @force 21_196.0
  @notice 5
  @warning 4
  @angle 1
  @acro 0
  # After the first time.
  @tries 2
  @say_us 10_000_000
  # How often sticks ask whether they may take a vehicle over.
  @ask_us 1_000_000
  @height_us 1_500_000
  # Until its reply says that it misses channels that stopped.
  @own_us 1_500_000
  @starting "it was just switched on, and does not say yet whether others send its channels: try again in 5 s"
  @unarmed "no channels are sent over MSP before it is armed that way"
  # RC_CHANNELS_OVERRIDE: left alone, given back.
  @leave 65_535
  @release 65_534

  @doc "Whether this is a message of sticks."
  @spec mine?(non_neg_integer) :: boolean
  def mine?(id), do: id in [@manual, @override]

  @doc "A command of a client: `:arm`, `:disarm`, `{:disarm, :force}` or `{:mode, number}`."
  @spec command(
          Session.t(),
          :arm | :disarm | {:disarm, :force} | {:mode, byte},
          integer,
          {byte, byte},
          integer
        ) ::
          Session.t()
  def command(%{sticks: %{receiver: nil}} = session, want, command, from, _now) do
    cond do
      # There is nothing to do.
      want in [:disarm, {:disarm, :force}] and Armed.state(session) == :disarmed ->
        Output.acknowledge(session, command, from, :ACCEPTED)

      Tasks.any?(session, &match?(%{kind: __MODULE__, command: ^command, from: ^from}, &1)) ->
        Output.acknowledge(session, command, from, :IN_PROGRESS)

      Tasks.any?(session, &(&1.kind == __MODULE__)) ->
        refuse(session, command, from, "another client begins to steer it")

      not Tasks.room?(session) ->
        Output.acknowledge(session, command, from, :TEMPORARILY_REJECTED)

      true ->
        session |> Output.acknowledge(command, from, :IN_PROGRESS) |> look(want, command, from)
    end
  end

  def command(
        %{sticks: %{receiver: %{from: from, pending: {{command, from}, _until}}}} = session,
        :arm,
        command,
        from,
        _now
      ),
      do: Output.acknowledge(session, command, from, :IN_PROGRESS)

  # Others than its steerer may disarm it: the policy says which.
  def command(%{sticks: %{receiver: %{from: steers} = receiver}} = session, want, command, from, now) do
    mine? = steers == from

    changed =
      case want do
        :disarm -> Receiver.disarm(receiver, {command, from}, facts(session), false, now)
        {:disarm, :force} -> Receiver.disarm(receiver, {command, from}, facts(session), true, now)
        _other when not mine? and receiver.paused == nil -> {:error, "another client steers it"}
        :arm -> Receiver.arm(receiver, {command, from}, now)
        {:mode, mode} -> Receiver.mode(receiver, mode, now)
      end

    case changed do
      {:error, why} ->
        refuse(session, command, from, why)

      {:ok, receiver} when is_tuple(want) and elem(want, 0) == :mode ->
        session |> put(receiver) |> Output.acknowledge(command, from, :ACCEPTED)

      {:ok, receiver} ->
        session |> put(receiver) |> Output.acknowledge(command, from, :IN_PROGRESS)
    end
  end

  defp put(session, receiver), do: put_in(session.sticks.receiver, receiver)

  defp look(session, want, command, from) do
    [first | asks] = asks(Firmware.of(session.identity.firmware))

    Tasks.add(session, %{
      kind: __MODULE__,
      command: command,
      from: from,
      want: want,
      got: %{},
      asks: asks,
      tries: 0,
      ask: first
    })
  end

  @doc """
  A message of sticks. Those of an armed vehicle that nobody steers take it over, where MSP is its receiver. One of a
  client that does not steer is
  ignored, and a text says so now and then.
  """
  @spec message(Session.t(), struct, {byte, byte}, integer) :: Session.t()
  def message(%{sticks: %{receiver: %{from: from} = receiver}, system: system} = session, message, from, now) do
    cond do
      not ours?(message, system) ->
        session

      receiver.paused == nil ->
        put(session, steer(receiver, message, now))

      not leads?(message) ->
        session

      true ->
        resumed(session, Receiver.resume(receiver, from, facts(session), now), message, now)
    end
  end

  def message(%{sticks: %{receiver: %{paused: at} = receiver}} = session, message, from, now) when at != nil,
    do: session |> put(%{receiver | from: from}) |> message(message, from, now)

  def message(session, message, from, now) do
    cond do
      not ours?(message, session.system) -> session
      steered?(session) -> ignored(session, "another client steers it", now)
      Armed.state(session) != :armed -> ignored(session, @unarmed, now)
      not leads?(message) or asked?(session, now) or not Tasks.room?(session) -> session
      true -> put_in(session.sticks.asked_at, now) |> look({:steer, message}, nil, from)
    end
  end

  defp ours?(message, system), do: system in [Map.get(message, :target), Map.get(message, :target_system)]

  defp asked?(%{sticks: %{asked_at: at}} = session, now),
    do: (at != nil and now - at < @ask_us) or Tasks.any?(session, &(&1.kind == __MODULE__))

  # A message that leaves all channels alone, or gives them back, steers nothing.
  defp leads?(%M.ManualControl{}), do: true
  defp leads?(message), do: Enum.any?(override(message), fn {_n, us} -> us != nil end)

  defp steer(receiver, %M.ManualControl{} = message, now), do: Receiver.steer(receiver, sticks(message), now)

  defp steer(receiver, message, now) do
    case override(message) do
      none when none == %{} -> receiver
      channels -> Receiver.override(receiver, channels, now)
    end
  end

  defp resumed(session, {:ok, receiver}, message, now),
    do:
      session
      |> put(steer(receiver, message, now))
      |> Output.text(@notice, "Sticks are back: channels resume")

  defp resumed(session, {:error, why}, _message, now), do: ignored(session, why, now)

  defp ignored(%{sticks: %{ignored_at: at}} = session, why, now) do
    if at == nil or now - at > @say_us,
      do: put_in(session.sticks.ignored_at, now) |> Output.text(@notice, "Sticks ignored: #{why}"),
      else: session
  end

  # x is forward, y to the right, z thrust, r to the right; beyond ±1000 is invalid.
  defp sticks(%{x: x, y: y, z: z, r: r}), do: [axis(y), axis(x), throttle(z), axis(r)]
  defp axis(value) when value in -1000..1000, do: 1500 + div(value, 2)
  defp axis(_invalid), do: 1500
  defp throttle(value) when value in 0..1000, do: 1000 + value
  defp throttle(_invalid), do: 1000

  defp override(message) do
    for n <- 1..18,
        us = Map.fetch!(message, :"chan#{n}_raw"),
        change = change(n, us),
        into: %{},
        do: {n, if(change == :release, do: nil, else: change)}
  end

  defp change(n, 0), do: if(n <= 8, do: :release)
  defp change(n, @release) when n > 8, do: :release
  defp change(_n, @leave), do: nil
  defp change(_n, us) when us in 900..2100, do: us
  defp change(_n, _invalid), do: nil

  @doc "The channels that are due, and what follows from what the vehicle says."
  @spec due(Session.t(), integer) :: {Session.t(), [{:write, binary}]}
  def due(%{sticks: %{receiver: %{due: at} = receiver}} = session, now) when now >= at do
    {receiver, effects} = Receiver.step(receiver, facts(session), now)
    session = Enum.reduce(effects, put(session, receiver), &effect(&2, &1))
    receiver = session.sticks.receiver
    if receiver == nil or receiver.paused, do: {session, []}, else: write(session, now)
  end

  def due(session, _now), do: {session, []}

  @doc "Whether channels are sent in place of a transmitter's."
  @spec steered?(Session.t()) :: boolean
  def steered?(%{sticks: %{receiver: receiver}}), do: receiver != nil

  @doc "When channels are due, nil for none."
  @spec due_at(Session.t()) :: integer | nil
  def due_at(%{sticks: %{receiver: receiver}}), do: receiver && receiver.due

  @doc "No channels are sent any more."
  @spec stop(Session.t()) :: Session.t()
  def stop(session), do: put(session, nil)

  @doc "Until then that the vehicle misses no receiver does not show that somebody else sends channels."
  @spec unsure(Session.t(), until :: integer) :: Session.t()
  def unsure(session, until), do: update_in(session.sticks.unsure_until, &max(&1 || until, until))

  defp write(session, now) do
    {channels, receiver} = Receiver.frame(session.sticks.receiver, now)
    entries = for us <- channels, do: %{channel: us}
    {:ok, frame} = MavCodec.Msp.request(Identity.target(session.identity), "SET_RAW_RC", %{entries: entries})
    # They are the gateway's own that it does not miss.
    {session |> put(receiver) |> unsure(now + @own_us), [{:write, IO.iodata_to_binary(Frame.encode(frame))}]}
  end

  defp effect(session, {:done, {command, from}, _why}),
    do: Output.acknowledge(session, command, from, :ACCEPTED)

  defp effect(session, {:failed, {command, from}, why}),
    do: session |> Output.text(@warning, why) |> Output.acknowledge(command, from, :FAILED)

  defp effect(session, {:say, text}), do: Output.text(session, @warning, text)
  defp effect(session, :stop), do: stop(session)

  defp facts(%{readings: readings} = session) do
    %{
      armed: Armed.state(session),
      failsafe?: Modes.failsafe?(boxes(session)),
      lost?: lost?(session),
      reasons: Arming.names(Identity.target(session.identity), readings[:arming] || 0),
      height: height(session),
      channels: readings[:channels]
    }
  end

  # Positions are off by metres, and by an old height it may have climbed since.
  defp height(%{readings: %{alt_rel: height, alt_at: at} = readings, now: now}) when now - at <= @height_us,
    do: if(Readings.barometer?(readings), do: height)

  defp height(_session), do: nil

  # A failsafe shows it where the flags do not.
  defp lost?(%{readings: readings} = session) do
    armed? = Armed.state(session) != :disarmed

    cond do
      Modes.failsafe?(boxes(session)) ->
        true

      readings[:arming] == nil ->
        nil

      true ->
        session.identity |> Identity.target() |> Arming.rc_lost?(readings.arming, armed?) |> sure(session)
    end
  end

  defp sure(false, %{sticks: %{unsure_until: until}, now: now}) when until != nil and now < until, do: nil
  defp sure(lost?, _session), do: lost?

  defp boxes(session), do: session.readings[:boxes] || MapSet.new()

  defp refuse(session, nil, _from, why), do: ignored(session, why, session.now)

  defp refuse(session, command, from, why),
    do: session |> Output.text(@warning, "Not done: #{why}") |> Output.acknowledge(command, from, :DENIED)

  # --- what the vehicle is configured to be

  defp asks(%{receiver: {:feature, _bit}, features: features}),
    do: [{features, %{}}, {"RX_MAP", %{}}, {"MODE_RANGES", %{}}]

  defp asks(%{receiver: {:type, _msp}}),
    do: [
      {"MSP2_COMMON_SETTING", %{name_or_index: Msp.Params.Setting.request("receiver_type")}},
      {"RX_MAP", %{}},
      {"MODE_RANGES", %{}}
    ]

  @impl Tasks
  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{ask: {name, _values}, asks: asks} = task, {:ok, values}, now) do
    task = %{task | got: Map.merge(task.got, config(name, values))}

    case asks do
      [next | rest] -> Tasks.ask_next(session, task, %{got: task.got, asks: rest, tries: 0, ask: next})
      [] -> session |> Tasks.done(task) |> begin(task, now)
    end
  end

  def answer(session, task, _none, _now),
    do:
      session
      |> Tasks.done(task)
      |> refuse(task.command, task.from, "the vehicle does not say how its receiver is configured")

  defp config("FEATURE_CONFIG", %{features: features}), do: %{features: features}
  defp config("MSP2_COMMON_SETTING", %{value: <<type, _::binary>>}), do: %{receiver_type: type}
  defp config("RX_MAP", %{map: map}), do: %{map: map(map)}
  defp config("MODE_RANGES", %{entries: entries}), do: %{ranges: entries}
  defp config(_name, _cut_short), do: %{}

  # Each function has another channel.
  defp map(map) do
    channels = if is_binary(map), do: :binary.bin_to_list(map), else: map
    if channels == Enum.uniq(channels) and Enum.all?(channels, &(&1 < 16)), do: channels, else: []
  end

  defp begin(session, task, now) do
    target = {firmware, _version} = Identity.target(session.identity)
    boxes = boxes(session)
    facts = facts(session)

    with %{map: [_, _, _, _ | _], ranges: _} <- task.got,
         :ok <- started(session),
         {:ok, kind} <- Receiver.source(target, task.got, boxes, facts),
         :ok <- fits(task.want, facts.armed),
         {:ok, receiver} <-
           Receiver.new(firmware, kind, task.got, task.from, modes(task.want, firmware, boxes), now),
         {:ok, receiver} <- wanted(receiver, task, facts, now) do
      session = session |> Output.text(@notice, begun(kind)) |> put(receiver)

      if match?({:mode, _mode}, task.want),
        do: Output.acknowledge(session, task.command, task.from, :ACCEPTED),
        else: session
    else
      {:error, why} ->
        refuse(session, task.command, task.from, why)

      :starting when task.command != nil ->
        session
        |> Output.text(@warning, "Not done: #{@starting}")
        |> Output.acknowledge(task.command, task.from, :TEMPORARILY_REJECTED)

      :starting ->
        ignored(session, @starting, now)

      _unknown ->
        refuse(session, task.command, task.from, "the vehicle does not say how its receiver is configured")
    end
  end

  # In its first seconds Betaflight does not miss a receiver.
  defp started(%{readings: readings} = session) do
    booting? = Arming.booting?(Identity.target(session.identity), readings[:arming] || 0)
    if booting? and lost?(session) == nil, do: :starting, else: :ok
  end

  # The channels that begin are those of a disarmed vehicle.
  defp fits(want, :disarmed) when want == :arm or elem(want, 0) == :mode, do: :ok
  defp fits({:steer, _message}, :armed), do: :ok
  defp fits(want, armed) when want in [:disarm, {:disarm, :force}] and armed != :disarmed, do: :ok
  defp fits(want, :disarmed) when want in [:disarm, {:disarm, :force}], do: :ok
  defp fits({:steer, _message}, _not), do: {:error, @unarmed}
  defp fits(_want, :armed), do: {:error, "it is armed: sticks take it over, or disarm it"}
  defp fits(_want, :unknown), do: {:error, "whether it is armed is not known: try again"}

  defp begun(:receiver), do: "Channels are sent over MSP now: the vehicle's receiver is MSP"
  defp begun(:override), do: "Channels are sent over MSP now: the pilot handed them over"

  # One that was asked for has to be that; otherwise it is the one that keeps it level, if it has a switch.
  defp modes({:mode, mode}, _firmware, _boxes), do: [mode]
  defp modes(_arm, firmware, boxes), do: Enum.uniq([@angle, Modes.mode(firmware, boxes), @acro]) -- [27]

  defp wanted(receiver, %{want: {:mode, _mode}}, _facts, _now), do: {:ok, receiver}

  defp wanted(receiver, %{want: :arm} = task, _facts, now),
    do: Receiver.arm(receiver, {task.command, task.from}, now)

  defp wanted(receiver, %{want: {:steer, message}}, _facts, now) do
    with {:ok, receiver} <- Receiver.take_over(receiver, now), do: {:ok, steer(receiver, message, now)}
  end

  defp wanted(receiver, %{want: want} = task, facts, now),
    do: Receiver.disarm(receiver, {task.command, task.from}, facts, want != :disarm, now)

  @doc "COMPONENT_ARM_DISARM and DO_SET_MODE as what is wanted; nil for what MSP does not have."
  @spec wish(:COMPONENT_ARM_DISARM | :DO_SET_MODE, struct, Modes.firmware()) :: term
  def wish(:COMPONENT_ARM_DISARM, %{param1: 1.0, param2: force}, _firmware) when force != @force, do: :arm

  def wish(:COMPONENT_ARM_DISARM, %{param1: p, param2: @force}, _firmware) when p == 0.0,
    do: {:disarm, :force}

  def wish(:COMPONENT_ARM_DISARM, %{param1: p}, _firmware) when p == 0.0, do: :disarm

  def wish(:DO_SET_MODE, %{param1: base, param2: number}, firmware)
      when is_float(base) and is_float(number) do
    # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED. A failsafe is not chosen.
    if Bitwise.band(trunc(base), 1) == 1 and number >= 0 and number < 256 and trunc(number) != 27 and
         Modes.name(firmware, trunc(number)),
       do: {:mode, trunc(number)}
  end

  def wish(_command, _params, _firmware), do: nil
end
