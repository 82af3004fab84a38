defmodule Aerie.Fleet.Shadow.Loop.Holds do
  @moduledoc """
  Operators other than the gateway: while one is in charge, and for a configured time afterwards, the shadow does
  nothing to the vehicle. A pure value.

  | held by | when |
  |---|---|
  | `failsafe` | the vehicle is in a failsafe |
  | `rc` | it is armed in a mode that is flown by sticks and its receiver is healthy, or a stick or switch moved |
  | `operator` | somebody commanded it directly: over NATS, REST, Elixir, or a ground station through the gateway |
  | `begun` | the gateway has just begun to watch it, and it is or may be armed |
  | `other` | its mode or arming changed without a command through this gateway: a switch, another ground station, the vehicle itself |

  Changes within ten seconds of a known command are taken for its effect.
  """

  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Vehicle.Snapshot

  defstruct hold_us: 30_000_000, seen: nil, sticks: nil, expected_until: nil, commanded_at: nil, until: %{}

  @typedoc """
    * `:until` - when each hold ends; `:now` while its cause lasts
    * `:seen` - mode and arming when last compared; `:sticks` - pulse widths in µs from which a movement is measured
    * `:expected_until` - until when a change is taken for the effect of a known command
  """
  @type t :: %__MODULE__{
          hold_us: non_neg_integer(),
          seen: {String.t() | nil, boolean() | nil} | nil,
          sticks: [integer() | nil] | nil,
          expected_until: integer() | nil,
          commanded_at: integer() | nil,
          until: %{by() => integer()}
        }
  @type by :: :failsafe | :rc | :operator | :begun | :other
  @typedoc "`until` is unix microseconds, nil while the end is not known."
  @type hold :: %{by: String.t(), until: integer() | nil, why: String.t()}

  @effect_us 10_000_000
  # Sticks and their switches. A trim or a noisy receiver stays below this.
  @channels 8
  @moved_us 40
  @flown_by_sticks ~w(STABILIZE STABILIZED ACRO MANUAL ALT_HOLD ALTCTL POSHOLD POSCTL SPORT DRIFT FBWA FBWB CRUISE TRAINING
    QSTABILIZE QHOVER QACRO STEERING RATTITUDE FLIP AUTOTUNE QAUTOTUNE)
  @why %{
    failsafe: "the vehicle is in a failsafe, or was until lately",
    rc: "a pilot flies it, or did until lately",
    operator: "it was commanded directly",
    begun: "the gateway has only begun to watch it",
    other: "its mode or arming changed, and nobody here commanded that"
  }

  @doc "No observation yet. `hold_us`: how long a hold lasts after its cause has ended."
  @spec new(hold_us :: non_neg_integer()) :: t()
  def new(hold_us), do: %__MODULE__{hold_us: hold_us}

  @doc "Takes the vehicle's snapshot at `now` (unix microseconds), and who commanded it last."
  @spec observe(t(), map(), RecentCommands.t() | nil, now :: integer()) :: t()
  def observe(holds, snapshot, commanded, now) do
    mode = Snapshot.data(snapshot, :mode)

    holds
    |> commanded(commanded)
    |> changed({mode[:mode], mode[:armed]}, now)
    |> failsafe(mode[:failsafe] == true, now)
    |> sticks(Snapshot.data(snapshot, :rc)[:channels], now)
    |> flown(mode, Snapshot.data(snapshot, :health)[:rc_receiver], now)
  end

  @doc "Records that the shadow itself sends something: changes that follow are its effect."
  @spec acted(t(), now :: integer()) :: t()
  def acted(holds, now), do: %{holds | expected_until: now + @effect_us}

  @doc "The clock was set by so many microseconds: every hold lasts as long as before."
  @spec moved(t(), integer()) :: t()
  def moved(holds, step) do
    until = Map.new(holds.until, fn {by, until} -> {by, until + step} end)
    %{holds | until: until, expected_until: holds.expected_until && holds.expected_until + step}
  end

  @doc "The holds in force at `now`, the longest first."
  @spec active(t(), now :: integer()) :: [hold()]
  def active(holds, now) do
    for {by, until} <- Enum.sort_by(holds.until, fn {by, until} -> {-until, by} end), until > now do
      %{by: Atom.to_string(by), until: until, why: @why[by]}
    end
  end

  defp commanded(%{commanded_at: seen} = holds, %{at: at}) when at != seen,
    do: %{
      hold(holds, :operator, at)
      | commanded_at: at,
        expected_until: max(holds.expected_until || at, at + @effect_us)
    }

  defp commanded(holds, _none_or_known), do: holds

  # Nobody knows who flew it a moment ago.
  defp changed(%{seen: nil} = holds, {_mode, armed} = seen, now) when armed != false,
    do: hold(%{holds | seen: seen}, :begun, now)

  defp changed(%{seen: nil} = holds, seen, _now), do: %{holds | seen: seen}
  defp changed(%{seen: seen} = holds, seen, _now), do: holds
  # The mode becomes known for the first time.
  defp changed(%{seen: {nil, _armed}} = holds, seen, _now), do: %{holds | seen: seen}

  defp changed(holds, seen, now) do
    expected? = holds.expected_until != nil and now < holds.expected_until
    holds = %{holds | seen: seen}
    if expected?, do: holds, else: hold(holds, :other, now)
  end

  defp failsafe(holds, true, now), do: hold(holds, :failsafe, now)
  defp failsafe(holds, false, _now), do: holds

  defp sticks(holds, [_ | _] = channels, now) do
    channels = Enum.take(channels, @channels)

    cond do
      holds.sticks == nil -> %{holds | sticks: channels}
      moved?(holds.sticks, channels) -> hold(%{holds | sticks: channels}, :rc, now)
      true -> holds
    end
  end

  defp sticks(holds, _unheard, _now), do: holds

  # A channel that appears or vanishes is a receiver that was switched on or off.
  defp moved?(before, now) do
    length(before) != length(now) or
      before
      |> Enum.zip(now)
      |> Enum.any?(fn {a, b} -> a != b and (a == nil or b == nil or abs(a - b) >= @moved_us) end)
  end

  defp flown(holds, %{armed: true, mode: mode}, receiver, now)
       when mode in @flown_by_sticks and (receiver == true or (receiver == nil and holds.sticks != nil)),
       do: hold(holds, :rc, now)

  defp flown(holds, _mode, _receiver, _now), do: holds

  defp hold(holds, by, from),
    do: %{holds | until: Map.update(holds.until, by, from + holds.hold_us, &max(&1, from + holds.hold_us))}
end
