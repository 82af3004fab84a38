defmodule Msp.Receiver do
  @period_us 40_000
  @settle_us 2_200_000
  @arm_us 8_000_000
  @disarm_us 2_000_000
  # Until a vehicle believes a receiver that is back.
  @recover_us 5_000_000
  @idle_us 10_000_000
  @steered_us 1_000_000
  @leave_us 2_000_000
  @paused_us 200_000

  @moduledoc """
  The channels of a receiver that a session sends in the place of a transmitter (SET_RAW_RC): the only way to arm over MSP, or to select a mode. A
  value; the caller sends what `frame/2` says every #{div(@period_us, 1000)} ms, and tells it what the vehicle reports (`step/3`).

  It may do so only where no transmitter is in charge (`source/4`): MSP is the receiver that is configured, or the pilot has handed the
  channels over (box MSP OVERRIDE), on the ground, and the firmware gives them back when they stop.

  - Safe channels come first, for #{@settle_us / 1_000_000} s: sticks in the middle, throttle low, disarmed. The arm switch goes up only if nothing keeps the vehicle from
    being armed and its own report of the channels is what was sent.
  - The ground station that armed it has to steer it. Without sticks for #{div(@steered_us, 1_000_000)} s, or without any for #{div(@idle_us, 1_000_000)} s after it was armed, it is
    over: on the ground the vehicle is disarmed; in the air the channels pause, so that the vehicle's own failsafe
    acts, which its owner has configured.
  - Where MSP is the receiver, the next sticks end a pause (`resume/4`), from anyone who may steer, and disarming does
    not need them.
  - What the vehicle does not confirm is not acknowledged as done.
  """

  alias Msp.{Firmware, Modes}
  alias Msp.Receiver.Switches

  @centre 1500
  @low 1000
  # iNav's failsafe_stick_threshold is 50.
  @nudged 1650
  @channels 16
  @msp_override 50
  # A throttle below that is idle; a vehicle that is higher flies.
  @idle_throttle 1100
  @height 1.0
  # How far a channel that the vehicle reports may be from the one that was sent.
  @near 5

  @another "another program sends its channels over MSP"

  @enforce_keys [:firmware, :kind, :map, :ranges, :from, :since, :until, :mode, :due]
  defstruct [
    :firmware,
    :kind,
    :map,
    :ranges,
    :from,
    :since,
    :until,
    :mode,
    :due,
    :sticks,
    :pending,
    :leaves,
    :paused,
    nudge: false,
    arm: :off,
    overrides: %{}
  ]

  @typedoc """
  - `kind`: `:receiver`, or `:override` of another one; `map`: the receiver's channel of each function (RX_MAP)
  - `from`: the client that steers; `until`: it has to be heard again before that
  - `sticks`: roll, pitch, throttle, yaw in µs, nil for the safe ones; `overrides`: channels by number from 1
  - `arm`: `:off`, `:wanted`, `:raised`, `:on`, `:lowered`; `pending`: the command that waits for it, and until when
  - `leaves`: when the channels stop, after the vehicle was disarmed; `paused`: since when none are sent, as nobody
    steers it
  - `nudge`: a stick is moved, without which iNav does not leave a failsafe
  """
  @type t :: %__MODULE__{}
  @type facts :: %{
          armed: :armed | :disarmed | :unknown,
          failsafe?: boolean,
          lost?: boolean | nil,
          reasons: [String.t()],
          height: number | nil,
          channels: [integer] | nil
        }
  @type effect :: {:done | :failed, command :: term, String.t() | nil} | {:say, String.t()} | :stop

  @doc """
  Whether the session may send channels: as the receiver, or in place of another one. `config`: `features` of Betaflight, `receiver_type` of iNav; `lost?`:
  whether the vehicle misses its receiver, nil if it does not say. One that is armed, or may be, has to have MSP as its
  receiver.
  """
  @spec source(MavCodec.Msp.Guard.target(), map, MapSet.t(byte), facts) ::
          {:ok, :receiver | :override} | {:error, String.t()}
  def source({name, version}, config, boxes, facts) do
    firmware = Firmware.of(name)
    override? = @msp_override in boxes

    cond do
      receiver?(firmware, config) and facts.lost? == false ->
        {:error, @another}

      receiver?(firmware, config) ->
        {:ok, :receiver}

      facts.armed == :armed ->
        {:error, "it was armed by its pilot, whose transmitter is in charge"}

      facts.armed == :unknown ->
        {:error, "whether it is armed is not known: try again"}

      override? and not hands_back?({name, version}) ->
        {:error, "Betaflight before 2026.6 keeps the last channels of MSP OVERRIDE for ever if they stop"}

      override? ->
        {:ok, :override}

      true ->
        {:error,
         "a transmitter is in charge: neither is MSP its receiver (#{firmware.receiver_setting}), nor is MSP OVERRIDE switched on"}
    end
  end

  @doc "Whether a vehicle has its own receiver's channels again when overridden ones stop: iNav, and Betaflight from 2026.6."
  @spec hands_back?(MavCodec.Msp.Guard.target()) :: boolean
  def hands_back?({firmware, version}), do: version >= Firmware.of(firmware).hands_back

  defp receiver?(%{receiver: {:feature, bit}}, %{features: features}),
    do: Bitwise.band(features, Bitwise.bsl(1, bit)) != 0

  defp receiver?(%{receiver: {:type, msp}}, %{receiver_type: type}), do: type == msp
  defp receiver?(_firmware, _unknown), do: false

  @doc "Begins with safe channels, for a client. The mode is the first of these that its switches can select."
  @spec new(Modes.firmware(), :receiver | :override, map, from :: term, modes :: [byte], now :: integer) ::
          {:ok, t} | {:error, String.t()}
  def new(firmware, kind, %{map: map, ranges: ranges}, from, modes, now) do
    receiver = %__MODULE__{
      firmware: firmware,
      kind: kind,
      map: map,
      ranges: ranges,
      from: from,
      since: now,
      until: now + @idle_us,
      mode: 0,
      due: now
    }

    Enum.find_value(modes, {:error, "its switches select none of its modes alone"}, fn mode ->
      with {:error, _why} <- choose(%{receiver | mode: mode}, false),
           do: nil,
           else: ({:ok, _aux} -> {:ok, %{receiver | mode: mode}})
    end)
  end

  defp choose(receiver, armed?),
    do: Switches.choose(receiver.firmware, receiver.ranges, receiver.mode, armed?)

  # --- what the client wants

  @doc "Goes on with a vehicle that is armed already, with its arm switch on."
  @spec take_over(t, integer) :: {:ok, t} | {:error, String.t()}
  def take_over(receiver, now) do
    with {:ok, _aux} <- choose(receiver, true), do: {:ok, %{receiver | arm: :on, until: now + @steered_us}}
  end

  @doc "Sends channels again after a pause, for the client that steers now, unless another program sends them."
  @spec resume(t, from :: term, facts, integer) :: {:ok, t} | {:error, String.t()}
  def resume(receiver, from, facts, now) do
    if another?(receiver, facts, now),
      do: {:error, @another},
      else: {:ok, %{receiver | from: from, paused: nil, due: now, until: now + @steered_us}}
  end

  # What it says of its receiver is of before, at first.
  defp another?(%{paused: at}, facts, now), do: at != nil and now - at > @steered_us and facts.lost? == false

  @doc "Arm, once safe channels were long enough."
  @spec arm(t, command :: term, integer) :: {:ok, t} | {:error, String.t()}
  def arm(%{arm: :on}, _command, _now), do: {:error, "it is armed"}

  def arm(receiver, command, now) do
    with {:ok, _aux} <- choose(receiver, true) do
      {:ok,
       %{
         receiver
         | arm: :wanted,
           # Those of before are no longer held.
           sticks: nil,
           overrides: %{},
           leaves: nil,
           pending: {command, now + @arm_us},
           until: max(receiver.until, now + @arm_us + @idle_us)
       }}
    end
  end

  @doc "Disarm. `fall?`: even in the air."
  @spec disarm(t, command :: term, facts, fall? :: boolean, integer) :: {:ok, t} | {:error, String.t()}
  def disarm(receiver, command, facts, fall?, now) do
    cond do
      another?(receiver, facts, now) ->
        {:error, @another}

      flying?(receiver, facts) and not fall? ->
        {:error, airborne(facts)}

      true ->
        patience = if facts.lost? == false, do: @disarm_us, else: @recover_us

        {:ok,
         %{
           safe(receiver)
           | arm: :lowered,
             paused: nil,
             due: min(receiver.due, now),
             pending: {command, now + patience},
             until: now + @idle_us
         }}
    end
  end

  defp airborne(%{height: nil}), do: "it is in the air, as far as is known: it does not say how high it is"
  defp airborne(_facts), do: "it is in the air"

  @doc "Selects a mode."
  @spec mode(t, byte, integer) :: {:ok, t} | {:error, String.t()}
  def mode(%{paused: at}, _mode, _now) when at != nil,
    do: {:error, "nobody steers it: send sticks first"}

  def mode(receiver, mode, now) do
    changed = %{receiver | mode: mode}

    with {:ok, _aux} <- choose(changed, receiver.arm in [:raised, :on]) do
      {:ok, %{changed | until: longer(receiver, now)}}
    end
  end

  @doc "Sticks: roll, pitch, throttle, yaw in µs."
  @spec steer(t, [integer], integer) :: t
  def steer(receiver, sticks, now),
    do: %{receiver | sticks: Enum.map(sticks, &within/1), until: now + @steered_us}

  @doc "Channels by number from 1; nil gives one back. Those that arm are not touched."
  @spec override(t, %{pos_integer => integer | nil}, integer) :: t
  def override(receiver, channels, now) do
    arming = for aux <- Switches.arming(receiver.ranges), do: aux + 5

    overrides =
      for {n, us} <- Map.drop(channels, arming), n <= @channels, reduce: receiver.overrides do
        all -> if us, do: Map.put(all, n, within(us)), else: Map.delete(all, n)
      end

    # Nothing but the middle and a low throttle, until they are taken again.
    if overrides == %{} and receiver.sticks == nil,
      do: %{receiver | overrides: overrides},
      else: %{receiver | overrides: overrides, until: now + @steered_us}
  end

  defp within(us), do: us |> max(@low) |> min(2000)

  # --- what is sent

  @doc "The channels now, in the order of the vehicle's own: roll, pitch, throttle, yaw and the others."
  @spec channels(t) :: [integer]
  def channels(receiver) do
    {:ok, aux} =
      with {:error, _why} <- choose(receiver, receiver.arm in [:raised, :on]), do: {:ok, %{}}

    roll = if receiver.nudge, do: @nudged, else: @centre

    all =
      (receiver.sticks || [roll, @centre, @low, @centre]) ++
        for n <- 0..(@channels - 5), do: aux[n] || @low

    for {us, n} <- Enum.with_index(all, 1), do: Map.get(receiver.overrides, n, us)
  end

  @doc "The channels in the order of SET_RAW_RC, which is the receiver's."
  @spec frame(t, integer) :: {[integer], t}
  def frame(receiver, now) do
    [roll, pitch, throttle, yaw | aux] = channels(receiver)
    functions = [roll, pitch, yaw, throttle | aux]
    placed = for {us, n} <- Enum.with_index(functions), into: %{}, do: {Enum.at(receiver.map, n, n), us}
    {for(n <- 0..(@channels - 1), do: Map.get(placed, n, @low)), %{receiver | due: now + @period_us}}
  end

  # --- what follows from what the vehicle says

  @doc "A look at what the vehicle says, and at the time."
  @spec step(t, facts, integer) :: {t, [effect]}
  def step(%{leaves: at} = receiver, _facts, now) when at != nil and now >= at, do: {receiver, [:stop]}

  # The vehicle's failsafe has disarmed it.
  def step(%{paused: at} = receiver, %{armed: :disarmed}, _now) when at != nil, do: {receiver, [:stop]}

  def step(%{paused: at} = receiver, _facts, now) when at != nil,
    do: {%{receiver | due: now + @paused_us}, []}

  def step(%{until: until} = receiver, facts, now) when now > until do
    cond do
      receiver.leaves ->
        {safe(receiver), []}

      flying?(receiver, facts) and receiver.kind == :receiver ->
        {%{receiver | sticks: nil, overrides: %{}, pending: nil, paused: now, due: now + @paused_us},
         failed(receiver, "nobody steers it") ++
           [{:say, "Nobody steers it: channels stopped, so that its failsafe acts; sticks resume them"}]}

      # Its pilot's transmitter has it.
      flying?(receiver, facts) ->
        {receiver,
         failed(receiver, "nobody steers it") ++
           [{:say, "Nobody steers it: channels stopped, so that its failsafe acts"}, :stop]}

      true ->
        {%{safe(receiver) | leaves: now + @leave_us, pending: nil},
         failed(receiver, "nobody steers it") ++ [{:say, "Nobody steers it: disarmed, channels stop"}]}
    end
  end

  def step(%{arm: :wanted} = receiver, facts, now) do
    ready? =
      now - receiver.since >= @settle_us and facts.armed == :disarmed and facts.reasons == [] and
        seen?(receiver, facts)

    cond do
      ready? -> {%{receiver | arm: :raised}, []}
      late?(receiver, now) -> {%{safe(receiver) | pending: nil}, failed(receiver, not_armed(receiver, facts))}
      true -> {receiver, []}
    end
  end

  def step(%{arm: :raised} = receiver, facts, now) do
    cond do
      facts.armed == :armed ->
        {%{receiver | arm: :on, pending: nil, until: longer(receiver, now)}, done(receiver)}

      late?(receiver, now) or now - receiver.since > 60 * @arm_us ->
        {%{safe(receiver) | pending: nil}, failed(receiver, not_armed(receiver, facts))}

      true ->
        {receiver, []}
    end
  end

  def step(%{arm: :on} = receiver, %{armed: :disarmed}, now),
    do:
      {%{safe(receiver) | leaves: now + @leave_us},
       [{:say, "It disarmed by itself: its arm switch is off now, channels stop"}]}

  def step(%{arm: :lowered} = receiver, facts, now) do
    cond do
      facts.armed == :disarmed ->
        {%{safe(receiver) | pending: nil, leaves: now + @leave_us}, done(receiver)}

      late?(receiver, now) and receiver.pending != nil ->
        {%{receiver | pending: nil}, failed(receiver, "its arm switch is off, but it says that it is armed")}

      true ->
        {%{receiver | nudge: Firmware.of(receiver.firmware).nudged? and facts.failsafe?}, []}
    end
  end

  def step(receiver, _facts, _now), do: {receiver, []}

  defp safe(receiver), do: %{receiver | arm: :off, sticks: nil, overrides: %{}, nudge: false}

  # Steering lapses unless it goes on.
  defp longer(%{sticks: nil, overrides: none} = receiver, now) when none == %{},
    do: if(receiver.arm == :wanted, do: receiver.until, else: now + @idle_us)

  defp longer(receiver, _now), do: receiver.until

  defp late?(%{pending: {_command, at}}, now), do: now > at
  defp late?(_receiver, _now), do: true

  defp done(%{pending: {command, _at}}), do: [{:done, command, nil}]
  defp done(_nothing), do: []

  defp failed(%{pending: {command, _at}}, why), do: [{:failed, command, why}]
  defp failed(_nothing, _why), do: []

  defp not_armed(_receiver, %{reasons: [_ | _] = names}), do: "Arming disabled: " <> Enum.join(names, ", ")

  defp not_armed(receiver, facts) do
    if seen?(receiver, facts),
      do: "it did not arm, and does not say why",
      else: "its channels are not those that were sent: another receiver is in charge of them"
  end

  # While they are safe, the sticks and the arm switch have to arrive as they were sent.
  defp seen?(receiver, %{channels: channels}) when is_list(channels) do
    own = channels(receiver)
    numbers = [1, 2, 3, 4] ++ for aux <- Switches.arming(receiver.ranges), do: aux + 5

    Enum.all?(numbers, fn n ->
      us = Enum.at(channels, n - 1)
      us != nil and abs(us - Enum.at(own, n - 1)) <= @near
    end)
  end

  defp seen?(_receiver, _facts), do: false

  # Betaflight does not say so. What is not known flies.
  defp flying?(receiver, facts) do
    throttle = receiver |> channels() |> Enum.at(2)

    facts.armed != :disarmed and
      (throttle > @idle_throttle or facts.height == nil or abs(facts.height) > @height)
  end
end
