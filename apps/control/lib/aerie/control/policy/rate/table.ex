defmodule Aerie.Control.Policy.Rate.Table do
  @moduledoc """
  The rates of a gateway's sources (`Aerie.Control.Policy.Rate`), in `Aerie.Control.Policy.Memory.ClientHistory`: any
  process takes a token without waiting for another one.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Rate
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Vehicle.Command.Refusal

  @typedoc "Raw MAVLink of a source has rates of its own."
  @type kind :: :rate | :command_rate

  @doc "Takes a token for a command of a source, or says when there will be one."
  @spec take(
          Names.gateway(),
          Policy.t(),
          kind(),
          source :: String.t(),
          vehicle :: String.t(),
          type :: String.t()
        ) ::
          :ok | Refusal.denial()
  def take(gateway, policy, kind, source, vehicle, type) do
    answer =
      update(gateway, kind, source, vehicle, &Rate.take(&1, policy, source, vehicle, type, &2))

    if answer == :full, do: Rate.full(source), else: answer
  end

  @doc "Puts a token back that was taken for what turned out to be a repetition."
  @spec put_back(Names.gateway(), Policy.t(), kind(), source :: String.t(), String.t(), type :: String.t()) ::
          :ok
  def put_back(gateway, policy, kind, source, vehicle, type) do
    update(gateway, kind, source, vehicle, fn rate, _now ->
      {:ok, Rate.put_back(rate, policy, source, vehicle, type)}
    end)

    :ok
  end

  defp update(gateway, kind, source, vehicle, fun) do
    now = System.monotonic_time(:microsecond)

    ClientHistory.update(gateway, {source, kind, vehicle}, now, fn before ->
      rate = before || Rate.new()

      case fun.(rate, now) do
        {:ok, ^rate} -> {:keep, :ok}
        {:ok, rate} -> {:put, :ok, rate, Rate.full_at(rate, now)}
        deny -> {:keep, deny}
      end
    end)
  end
end
