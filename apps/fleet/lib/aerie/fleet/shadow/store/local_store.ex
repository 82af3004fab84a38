defmodule Aerie.Fleet.Shadow.Store.LocalStore do
  @moduledoc """
  The shadow's folder on disk, for its owner only: a copy of each desired document, the key that seals them, and the name
  by which this gateway claims vehicles. With `nats.mode: off` the copies are the only storage.
  """

  alias Aerie.Base.Files.{Damaged, Format, Private}
  alias Aerie.Base.Names
  alias Aerie.Base.Secret

  @max_bytes 131_072
  @format {"shadow", 1}

  @doc """
  Opens the folder of a gateway: returns the key and the gateway's name, which are created if they do not exist or
  cannot be read.
  """
  @spec open(Names.gateway(), Path.t(), Secret.t() | nil) ::
          {:ok, %{key: Secret.t(), instance: String.t()}} | {:error, String.t()}
  def open(gateway, dir, key) do
    with :ok <- Private.folder(Path.join(dir, "desired")),
         :ok <- Format.mark(gateway, dir, @format),
         {:ok, instance} <- kept(gateway, Path.join(dir, "instance"), "vehicles are claimed under a new name"),
         {:ok, key} <- if(key, do: {:ok, key}, else: kept_key(gateway, dir)) do
      {:ok, %{key: key, instance: String.slice(instance, 0, 16)}}
    else
      {:error, text} when is_binary(text) -> {:error, text}
      {:error, reason} -> {:error, "#{dir}: #{:file.format_error(reason)}"}
    end
  end

  @doc "Kind and version of its folder."
  @spec format() :: Format.kind()
  def format, do: @format

  @doc "A key and a name that are not stored, for a folder that cannot be written."
  @spec without_folder(Secret.t() | nil) :: %{key: Secret.t(), instance: String.t()}
  def without_folder(key), do: %{key: key || Secret.new(random()), instance: String.slice(random(), 0, 16)}

  defp kept_key(gateway, dir) do
    words = "desired states that were sealed before have to be given again"
    with {:ok, text} <- kept(gateway, Path.join(dir, "key"), words), do: {:ok, Secret.new(text)}
  end

  defp kept(gateway, path, words) do
    with {:ok, text} <- File.read(path), true <- text =~ ~r/\A[0-9a-f]{64}\s*\z/ do
      {:ok, String.trim(text)}
    else
      damaged ->
        new = random()

        with :ok <- aside(damaged, gateway, path, words),
             :ok <- Private.write(path, new),
             do: {:ok, new}
    end
  end

  defp aside({:error, :enoent}, _gateway, _path, _words), do: :ok

  defp aside(_damaged, gateway, path, words),
    do: with({:ok, _kept} <- Damaged.set_aside(gateway, path, words), do: :ok)

  defp random, do: Base.encode16(:crypto.strong_rand_bytes(32), case: :lower)

  @doc "Writes the copy of a vehicle's document."
  @spec write(Path.t(), vehicle :: String.t(), iodata()) :: :ok | {:error, String.t()}
  def write(dir, vehicle, text) do
    with {:error, reason} <- Private.write(path(dir, vehicle), text),
         do: {:error, "#{path(dir, vehicle)}: #{:file.format_error(reason)}"}
  end

  @doc "The copy of a vehicle's document as it was written, or nil."
  @spec read(Path.t(), vehicle :: String.t()) :: binary() | nil
  def read(dir, vehicle) do
    path = path(dir, vehicle)

    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         do: text,
         else: (_none -> nil)
  end

  # Callers have checked that a vehicle's name is a token.
  defp path(dir, vehicle), do: Path.join([dir, "desired", vehicle <> ".json"])
end
