defmodule Aerie.Bridge.Memory.File do
  @moduledoc "The file of `Aerie.Bridge.Memory`: JSON, replaced as a whole. What is no such file counts as none."

  alias Aerie.PrivateFile
  alias Aerie.Vehicle.Detector.Found

  # 4096 vehicles have half of that.
  @max_bytes 2_097_152

  @typedoc "`epoch` of the life that wrote it, nil for none; `ended`: whether that life ended in order."
  @type t :: %{epoch: pos_integer() | nil, ended: boolean(), vehicles: %{String.t() => Found.t()}}

  @doc "What is kept."
  @spec read(Path.t() | nil) :: t()
  def read(nil), do: none()

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

  defp none, do: %{epoch: nil, ended: false, vehicles: %{}}

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

  @doc "Replaces what is kept."
  @spec write(Path.t(), t()) :: :ok | {:error, File.posix()}
  def write(file, kept), do: PrivateFile.write(file, JSON.encode!(kept))
end
