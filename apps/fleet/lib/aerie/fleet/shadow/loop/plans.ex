defmodule Aerie.Fleet.Shadow.Loop.Plans do
  @moduledoc """
  Plan files by their hashes: the SHA-256 of a QGroundControl `.plan` file. A desired state refers to a hash. Storing
  a file commands nothing, and nobody can change the file behind a hash.

  They are in the bucket `fleet_plans` with the hash as key. Copies of the last 300 are in `shadow.dir/plans`.
  """

  alias Aerie.Base.Files.Private
  alias Aerie.Base.Names
  alias Aerie.Control.Missions
  alias Protocols.Mission.Plan
  alias Aerie.Fleet.Shadow.Documents
  alias Aerie.Fleet.Shadow.Store.{Buckets, HubBuckets}

  # A NATS message has at most a megabyte by default.
  @max_bytes 524_288
  @max_copies 300

  @doc "The largest file in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "Stores a `.plan` file; returns its hash."
  @spec put(Names.gateway(), binary()) ::
          {:ok, hash :: String.t()} | {:error, {:invalid | :unavailable, String.t()}}
  def put(gateway, text) do
    hash = hash(text)

    with :ok <- size(text),
         {:ok, _plan} <- read(text),
         {:ok, dir} <- dir(gateway),
         :ok <- keep(dir, hash, text),
         :ok <- publish(gateway, hash, text) do
      {:ok, hash}
    end
  end

  defp size(text) when byte_size(text) <= @max_bytes, do: :ok
  defp size(_text), do: {:error, {:invalid, "the file is larger than #{@max_bytes} bytes"}}

  defp read(text) do
    with {:ok, plan} <- Missions.import(text, :plan),
         nil <- Missions.unsendable(plan) do
      {:ok, plan}
    else
      {:error, why} -> {:error, {:invalid, why}}
      why -> {:error, {:invalid, why}}
    end
  end

  defp dir(gateway) do
    with nil <- Documents.dir(gateway),
         do: {:error, {:unavailable, "the shadow does not run"}},
         else: (dir -> {:ok, dir})
  end

  defp publish(gateway, hash, text) do
    case Documents.nats(gateway) do
      nil ->
        :ok

      {conn, _environment} ->
        with {:error, why} <- Buckets.put_plan(conn, hash, text), do: {:error, {:unavailable, why}}
    end
  end

  @doc "The plan of a hash, from the copies or from NATS."
  @spec fetch(Names.gateway(), hash :: String.t()) :: {:ok, Plan.t()} | {:error, String.t()}
  def fetch(gateway, hash) do
    with dir when dir != nil <- Documents.dir(gateway),
         {:ok, text} <- text(gateway, dir, hash) do
      Missions.import(text, :plan)
    else
      _none -> {:error, "no plan with this hash is stored (docs/shadow.md)"}
    end
  end

  defp text(gateway, dir, hash) do
    with :error <- genuine(File.read(path(dir, hash)), hash),
         {conn, _environment} <- Documents.nats(gateway),
         {:ok, text} <- in_nats(conn, hash) do
      _copy = keep(dir, hash, text)
      {:ok, text}
    end
  end

  # On a leaf node the hub may have it.
  defp in_nats(conn, hash) do
    with :error <- genuine(Buckets.plan(conn, hash), hash),
         {:ok, text, _revision} <- HubBuckets.get(conn, "fleet_plans", hash),
         do: genuine({:ok, text}, hash)
  end

  defp genuine({:ok, text}, hash), do: if(hash(text) == hash, do: {:ok, text}, else: :error)
  defp genuine(_none, _hash), do: :error

  defp keep(dir, hash, text) do
    with :ok <- Private.folder(Path.join(dir, "plans")),
         :ok <- Private.write(path(dir, hash), text) do
      forget(Path.join(dir, "plans"))
    else
      {:error, reason} -> {:error, {:unavailable, "#{path(dir, hash)}: #{:file.format_error(reason)}"}}
    end
  end

  # The oldest first, by the time when they were stored.
  defp forget(dir) do
    aged =
      for name <- names(dir),
          path = Path.join(dir, name),
          {:ok, stat} <- [File.stat(path)],
          do: {stat.mtime, path}

    aged |> Enum.sort(:desc) |> Enum.drop(@max_copies) |> Enum.each(fn {_at, path} -> File.rm(path) end)
  end

  defp names(dir) do
    case File.ls(dir) do
      {:ok, names} -> names
      {:error, _gone} -> []
    end
  end

  # The table of fields has checked the hash, or it is our own.
  defp path(dir, hash), do: Path.join([dir, "plans", hash])
  defp hash(text), do: :crypto.hash(:sha256, text) |> Base.encode16(case: :lower)
end
