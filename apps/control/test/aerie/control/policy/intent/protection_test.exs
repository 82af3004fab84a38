defmodule Aerie.Control.Policy.Intent.ProtectionTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Intent.Protection
  alias MavCodec.Msp.{Params, ShortName}

  test "what a rescue and a failsafe of Betaflight do protects it, by the name of each version, whole or short" do
    for {_numbers, version, release} <- Params.releases(:betaflight),
        %{block: block, name: name} <- Params.all(:betaflight, version),
        block in ["GPS_RESCUE", "GPS_RESCUE_PIDS", "FAILSAFE_CONFIG"],
        name <- [name, String.upcase(name), ShortName.of(name)],
        do: assert(Protection.parameter?(name), "#{release} #{name}")

    for name <- ~w(p_roll osd_units vtx_power), do: refute(Protection.parameter?(name))
  end
end
