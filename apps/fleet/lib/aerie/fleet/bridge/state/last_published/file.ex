defmodule Aerie.Fleet.Bridge.State.LastPublished.File do
  @moduledoc """
  The file of `Aerie.Fleet.Bridge.State.LastPublished`: JSON. An invalid file counts as a missing one.

  It is replaced as a whole, but for its first number, `held`: the time until which the values of the vehicles that say
  `held` were right. That is overwritten in place, because a new file every ten seconds would be most of what an idle
  gateway writes to flash.
  """

  alias Aerie.Base.Files.{Private, Raw}
  alias Aerie.Vehicle.Events.Detector.OfflineChanges

  # 4096 vehicles take half of that.
  @max_bytes 2_097_152
  @held ~s({"held":)
  # Microseconds until the year 5138.
  @digits 17

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
        vehicles: for({id, known} <- vehicles, known = vehicle(known, kept), into: %{}, do: {id, known})
      }
    else
      _none_or_damaged -> none()
    end
  end

  @doc "Nothing is known."
  @spec none() :: t()
  def none, do: %{epoch: nil, ended: false, vehicles: %{}}

  defp vehicle(%{"held" => true, "since" => since} = known, %{"held" => held} = kept)
       when is_integer(since) and is_integer(held),
       do: vehicle(%{known | "held" => false, "since" => max(since, held)}, kept)

  defp vehicle(%{"since" => since} = known, _kept) when is_integer(since) do
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

  defp vehicle(_other, _kept), do: nil

  @doc "Replaces the file; what is `held` held at `now`."
  @spec write(Path.t(), t(), now :: integer()) :: :ok | {:error, File.posix()}
  def write(file, kept, now) do
    "{" <> rest = JSON.encode!(kept)
    Private.write(file, [@held, digits(now), ",", rest])
  end

  @doc "What is `held` still holds at `now`."
  @spec hold(Path.t(), now :: integer()) :: :ok | {:error, File.posix() | :badarg | :terminated}
  def hold(file, now) do
    # Opened for reading too, or it would be emptied.
    with {:ok, %{type: :regular}} <- Raw.stat(file),
         {:ok, result} <-
           File.open(file, [:read, :write, :raw], &:file.pwrite(&1, byte_size(@held), digits(now))),
         do: result
  end

  defp digits(now), do: now |> Integer.to_string() |> String.pad_leading(@digits)
end
