defmodule Aerie.Control.Policy.Mavlink.Sticks do
  @moduledoc """
  RC_CHANNELS_OVERRIDE and MANUAL_CONTROL: the channels, axes and buttons that they work, as `t:Aerie.Control.Policy.Intent.switches/0` has them.
  """

  import Bitwise

  alias Aerie.Control.Policy.Intent
  alias MavCodec.Messages, as: M

  @missing 32_767
  # The first two bits of the extensions are for axes more.
  @aux for n <- 1..6, do: {n, 1 <<< (n + 1)}

  @doc "What a message works."
  @spec switches(%M.RcChannelsOverride{} | %M.ManualControl{}) :: Intent.switches()
  def switches(%M.RcChannelsOverride{} = m),
    do: Intent.switches(channels: Map.new(names(), fn {name, n} -> {n, Map.fetch!(m, name)} end))

  def switches(%M.ManualControl{} = m) do
    Intent.switches(
      axes: %{pitch: axis(m.x), roll: axis(m.y), throttle: axis(m.z), yaw: axis(m.r)},
      buttons: Intent.pressed(m.buttons ||| m.buttons2 <<< 16),
      aux: for({n, bit} <- @aux, (m.enabled_extensions &&& bit) != 0, do: n)
    )
  end

  defp axis(@missing), do: nil
  defp axis(thousandths), do: thousandths

  for_names = for n <- 1..18, do: {:"chan#{n}_raw", n}
  defp names, do: unquote(for_names)
end
