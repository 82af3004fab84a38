defmodule Aerie.Mavlink.BootClock do
  @moduledoc """
  Follows the clock of one component of a vehicle (`time_boot_ms`) and tells when it began anew: a reboot (R6). A pure value.

  Each kind of message has a clock of its own, because firmware fills the field differently: Betaflight's
  GLOBAL_POSITION_INT has microseconds in it, beside an ATTITUDE in milliseconds. A clock is measured against the time of
  arrival. One that runs 200 times too fast or more is none; as soon as one has kept time, only those that have done so count.

  A clock that is more than two seconds behind what it was is a reboot only when it stays there: three readings in a row
  over at least a second. Frames that were overtaken (a slower second link, PX4's two sending threads) show an old time
  in between new ones and are not. The 32-bit wrap after 49.7 days is not either.
  """

  import Bitwise

  @enforce_keys [:seed]
  defstruct [:seed, clocks: %{}, proven: false]

  @tolerance_ms 2_000
  @readings 3
  @span_us 1_000_000
  @half 0x80000000
  # How long a clock runs before its pace is looked at; what is too fast to be milliseconds (simulators run up to 100 times
  # faster than time), and how often in a row it has to be: two vehicles with one id jump to and fro.
  @pace_us 500_000
  @too_fast 200
  @strikes 3

  @typep clock :: %{
           newest: non_neg_integer() | nil,
           behind: nil | {pos_integer(), since :: integer(), boot_ms :: non_neg_integer()},
           from: {at :: integer(), boot_ms :: non_neg_integer()},
           pace: :unknown | :good | non_neg_integer()
         }
  @typedoc "`seed`: what a clock that was not read yet goes on from; `pace`: a number is how often in a row it was too fast."
  @type t :: %__MODULE__{
          seed: non_neg_integer() | nil,
          clocks: %{non_neg_integer() => clock()},
          proven: boolean()
        }
  @type verdict :: :ok | :behind | :reboot | :none

  @doc "A clock that was last seen at `boot_ms`, or never."
  @spec new(non_neg_integer() | nil) :: t()
  def new(boot_ms \\ nil), do: %__MODULE__{seed: boot_ms}

  @doc """
  A reading by a kind of message that came `at`: `:ok` - the vehicle's time now; `:behind` - an overtaken frame, or the
  first sign of a reboot; `:reboot` - it has begun anew; `:none` - the message may be new or old, its clock is none.
  """
  @spec read(t(), id :: non_neg_integer(), non_neg_integer(), integer()) :: {t(), verdict()}
  def read(%{clocks: clocks, seed: seed} = all, id, boot_ms, at) do
    clock = Map.get(clocks, id) || %{newest: seed, behind: nil, from: {at, boot_ms}, pace: :unknown}
    {clock, verdict} = clock |> pace(boot_ms, at) |> step(boot_ms, at)

    if verdict == :reboot and believed?(all, clock) do
      {%__MODULE__{seed: nil, clocks: %{id => clock}, proven: clock.pace == :good}, :reboot}
    else
      all = %{all | clocks: Map.put(clocks, id, clock), proven: all.proven or clock.pace == :good}
      {all, if(believed?(all, clock), do: verdict, else: doubted(verdict))}
    end
  end

  # What is overtaken is old, whatever its clock counts.
  defp doubted(:behind), do: :behind
  defp doubted(_verdict), do: :none

  defp believed?(%{proven: proven}, %{pace: pace}), do: pace == :good or not (proven or fast?(pace))

  defp fast?(pace), do: is_integer(pace) and pace >= @strikes

  defp pace(%{from: {since, _boot_ms}} = clock, _boot, at) when at >= since and at - since < @pace_us,
    do: clock

  defp pace(%{from: {since, from}} = clock, boot_ms, at) do
    gone_us = (boot_ms - from) * 1000

    pace =
      cond do
        # Begun anew or wrapped; another vehicle's, if it was not sure yet.
        at < since or gone_us < 0 ->
          if is_integer(clock.pace) and not fast?(clock.pace), do: 0, else: clock.pace

        gone_us < (at - since) * @too_fast ->
          :good

        is_integer(clock.pace) ->
          clock.pace + 1

        true ->
          1
      end

    %{clock | from: {at, boot_ms}, pace: pace}
  end

  defp step(%{newest: nil} = clock, boot_ms, _at), do: {%{clock | newest: boot_ms}, :ok}

  defp step(clock, boot_ms, at) do
    cond do
      fast?(clock.pace) -> {%{clock | newest: boot_ms, behind: nil}, :none}
      ahead?(boot_ms, clock.newest) -> {%{clock | newest: boot_ms, behind: nil}, :ok}
      clock.newest - boot_ms <= @tolerance_ms -> {%{clock | behind: nil}, :ok}
      true -> behind(clock, boot_ms, at)
    end
  end

  defp behind(%{behind: nil} = clock, boot_ms, at), do: {%{clock | behind: {1, at, boot_ms}}, :behind}

  defp behind(%{behind: {count, since, from}} = clock, boot_ms, at) do
    if count + 1 >= @readings and at - since >= @span_us and
         (boot_ms - from) * 1000 < (at - since) * @too_fast do
      {%{clock | newest: boot_ms, behind: nil}, :reboot}
    else
      {%{clock | behind: {count + 1, since, from}}, :behind}
    end
  end

  # After the wrap a small number is ahead of a big one. Half the range behind is never a reboot of interest: it takes
  # an uptime of more than 24 days.
  defp ahead?(boot_ms, newest) when boot_ms >= newest, do: true
  defp ahead?(boot_ms, newest), do: (boot_ms - newest &&& 0xFFFFFFFF) < @half and newest > 0xFFFFFFFF - 60_000
end
