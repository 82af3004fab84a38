defmodule Aerie.Control.Policy.Mavlink.Sticks do
  @moduledoc "RC_CHANNELS_OVERRIDE and MANUAL_CONTROL: the channels and buttons that they work, as `t:Aerie.Control.Policy.Intent.switches/0` has them."

  import Bitwise

  alias Aerie.Control.Policy.Intent
  alias MavCodec.Messages, as: M

  @ignored 65_535
  # Channels 9 and following are given back by it, and ignored by 0.
  @released 65_534

  @doc "The channels that are overridden, with their pulse widths."
  @spec channels(%M.RcChannelsOverride{}) :: %{(1..18) => integer()}
  def channels(message) do
    for {name, n} <- names(), us = Map.fetch!(message, name), overridden?(n, us), into: %{}, do: {n, us}
  end

  @doc "The buttons that are pressed."
  @spec buttons(%M.ManualControl{}) :: [0..31]
  def buttons(message), do: Intent.pressed(message.buttons ||| message.buttons2 <<< 16)

  for_names = for n <- 1..18, do: {:"chan#{n}_raw", n}
  defp names, do: unquote(for_names)

  # 0 gives one of the first eight back.
  defp overridden?(_n, us) when us in [0, @ignored], do: false
  defp overridden?(n, @released) when n > 8, do: false
  defp overridden?(_n, _us), do: true
end
