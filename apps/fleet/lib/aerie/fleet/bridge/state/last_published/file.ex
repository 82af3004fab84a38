defmodule Aerie.Fleet.Bridge.State.LastPublished.File do
  @moduledoc "The file of `Aerie.Fleet.Bridge.State.LastPublished`: JSON, replaced as a whole. An invalid file counts as a missing one."

  alias Aerie.Base.Files.Private
  alias Aerie.Vehicle.Events.Detector.OfflineChanges

  # 4096 vehicles take half of that.
  @max_bytes 2_097_152

  @typedoc "`epoch`: of the run that wrote it, nil if there is no file; `ended`: whether that run stopped in an orderly way."
  @type t :: %{epoch: pos_integer() | nil, ended: boolean(), vehicles: %{String.t() => OfflineChanges.t()}}

  @doc "The content of the file."
  @spec read(Path.t()) :: t()
  def read(file) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(file),
         {:ok, text} <- File.read(file),
         {:ok, %{"epoch" => epoch, "vehicles" => %{} = vehicles} = kept} when is_integer(epoch) <-
           JSON.decode(text) do
      %{
        epoch: epoch,
        ended: kept["ended"] == true,
        vehicles: for({id, known} <- vehicles, known = vehicle(known), into: %{}, do: {id, known})
      }
    else
      _none_or_damaged -> none()
    end
  end

  @doc "Nothing is known."
  @spec none() :: t()
  def none, do: %{epoch: nil, ended: false, vehicles: %{}}

  defp vehicle(%{"since" => since} = known) when is_integer(since) do
    for {name, key, right?} <- [
          {"mode", :mode, &is_binary/1},
          {"armed", :armed, &is_boolean/1},
          {"in_air", :in_air, &is_boolean/1},
          {"lost", :lost, &is_boolean/1}
        ],
        value = {known[name]},
        right?.(elem(value, 0)),
        into: %{since: since},
        do: {key, elem(value, 0)}
  end

  defp vehicle(_other), do: nil

  @doc "Replaces the file."
  @spec write(Path.t(), t()) :: :ok | {:error, File.posix()}
  def write(file, kept), do: Private.write(file, JSON.encode!(kept))
end
