defmodule MavCodec.Sniff.Text do
  @moduledoc """
  Finds readable text, and what prints it: a flight controller that boots, a boot loader, a shell.

  Text has no checksum, so nine of ten bytes have to be printable; a dozen random bytes never are.
  """

  @min_bytes 12
  @share 0.9

  @speakers [
    {~r/Init Ardu|ArduCopter|ArduPlane|ArduRover|ArduSub|AP_Logger|ChibiOS/, "ArduPilot starting"},
    {~r/nsh>|NuttShell|PX4|INFO +\[/, "PX4's console"},
    {~r/U-Boot/, "the boot loader U-Boot"},
    {~r/Linux version|Starting kernel|\[ +\d+\.\d{6}\]|systemd|login: ?|raspberrypi/, "a Linux console"},
    {~r/Entering CLI Mode|Betaflight|INAV|# +\z/, "the command line of Betaflight or iNav"},
    {~r/rst:0x|ESP-ROM|ets [A-Z][a-z]{2} /, "an ESP module starting"},
    {~r/PX4 BL|bootloader/i, "a boot loader"}
  ]

  @doc "`{:text, confidence, evidence}` or `:none`."
  @spec scan(binary) :: {:text, float, String.t()} | :none
  def scan(bytes) when byte_size(bytes) < @min_bytes, do: :none

  def scan(bytes) do
    printable = for <<byte <- bytes>>, printable?(byte), reduce: 0, do: (n -> n + 1)
    share = printable / byte_size(bytes)

    if share >= @share and several?(bytes),
      do: {:text, min(0.95, share * min(1.0, byte_size(bytes) / 40)), "#{speaker(bytes)}: #{line(bytes)}"},
      else: :none
  end

  defp printable?(byte), do: byte in 0x20..0x7E or byte in [?\r, ?\n, ?\t, ?\e]

  # At a wrong baud rate a regular pattern may look like UUUUUU.
  defp several?(bytes), do: length(Enum.uniq(for(<<byte <- bytes>>, do: byte))) >= 5

  defp speaker(bytes) do
    Enum.find_value(@speakers, "text", fn {pattern, who} -> if bytes =~ pattern, do: who end)
  end

  # The first meaningful line, shortened for a diagnosis.
  defp line(bytes) do
    plain = for <<byte <- bytes>>, into: "", do: if(byte in 0x20..0x7E, do: <<byte>>, else: "\n")

    plain
    |> String.split("\n")
    |> Enum.map(&String.trim/1)
    |> Enum.max_by(&min(String.length(&1), 12), fn -> "" end)
    |> String.slice(0, 60)
    |> inspect()
  end
end
