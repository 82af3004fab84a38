defmodule Aerie.Vehicle.BootClock do
  @moduledoc """
  Follows the vehicle's own clock (`time_boot_ms`) and tells when it began anew: a reboot (R6). A pure value.

  A clock that is more than two seconds behind what it was is a reboot only when it stays there: three readings in a row
  over at least a second. Frames that were overtaken (a slower second link, PX4's two sending threads) show an old time
  in between new ones and are not. The 32-bit wrap after 49.7 days is not either.
  """

  import Bitwise

  defstruct newest: nil, behind: nil

  @tolerance_ms 2_000
  @readings 3
  @span_us 1_000_000
  @half 0x80000000

  @type t :: %__MODULE__{newest: non_neg_integer() | nil, behind: nil | {pos_integer(), integer()}}

  @doc "A clock that was last seen at `boot_ms`, or never."
  @spec new(non_neg_integer() | nil) :: t()
  def new(boot_ms \\ nil), do: %__MODULE__{newest: boot_ms}

  @doc """
  A reading that came `at`: `:ok` - the vehicle's time now; `:behind` - an overtaken frame, or the first sign of a
  reboot; `:reboot` - it has begun anew.
  """
  @spec read(t(), non_neg_integer(), integer()) :: {t(), :ok | :behind | :reboot}
  def read(%{newest: nil}, boot_ms, _at), do: {%__MODULE__{newest: boot_ms}, :ok}

  def read(clock, boot_ms, at) do
    cond do
      ahead?(boot_ms, clock.newest) -> {%{clock | newest: boot_ms, behind: nil}, :ok}
      clock.newest - boot_ms <= @tolerance_ms -> {%{clock | behind: nil}, :ok}
      true -> behind(clock, boot_ms, at)
    end
  end

  defp behind(%{behind: nil} = clock, _boot_ms, at), do: {%{clock | behind: {1, at}}, :behind}

  defp behind(%{behind: {count, since}} = clock, boot_ms, at) do
    if count + 1 >= @readings and at - since >= @span_us do
      {%__MODULE__{newest: boot_ms}, :reboot}
    else
      {%{clock | behind: {count + 1, since}}, :behind}
    end
  end

  # After the wrap a small number is ahead of a big one. Half the range behind is never a reboot of interest: it takes
  # an uptime of more than 24 days.
  defp ahead?(boot_ms, newest) when boot_ms >= newest, do: true
  defp ahead?(boot_ms, newest), do: (boot_ms - newest &&& 0xFFFFFFFF) < @half and newest > 0xFFFFFFFF - 60_000
end
