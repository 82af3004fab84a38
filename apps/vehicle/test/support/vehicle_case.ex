defmodule Aerie.VehicleCase do
  @moduledoc "Tests of links and routing with vehicles behind them: `Aerie.LinkCase`, and sessions that are made as they are heard."
  use ExUnit.CaseTemplate

  using do
    quote do
      import Aerie.LinkCase, except: [start_parts: 0, start_parts: 1, start_parts: 2]
      import Aerie.VehicleCase
    end
  end

  @doc "Starts the parts of `Aerie.LinkCase.start_parts/2` and the vehicles; gives the gateway's name."
  @spec start_parts(map, keyword) :: reference
  def start_parts(config \\ %{}, more \\ []) do
    above = [options: Aerie.GatewayCase.plugs(config), above: [Aerie.Vehicle.Supervisor]]
    Aerie.LinkCase.start_parts(config, above ++ more)
  end

  @doc "As `Aerie.SigningCase.start_signing/2`, with vehicles."
  @spec start_signing(Path.t(), keyword) :: reference
  def start_signing(dir, options \\ []), do: Aerie.SigningCase.start_signing(dir, options, &start_parts/2)
end
