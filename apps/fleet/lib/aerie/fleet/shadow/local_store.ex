defmodule Aerie.Fleet.Shadow.LocalStore do
  @moduledoc """
  The shadow's folder on disk, for its owner only: a copy of each desired document, the key that seals them, and the name
  by which this gateway claims vehicles. With `nats.mode: off` the copies are the only storage.
  """

  alias Aerie.Base.Files.{Format, Private}
  alias Aerie.Base.Secret

  @max_bytes 131_072
  @format {"shadow", 1}

  @doc "Opens the folder: returns the key and this gateway's name, which are created if they do not exist."
  @spec open(Path.t(), Secret.t() | nil) ::
          {:ok, %{key: Secret.t(), instance: String.t()}} | {:error, String.t()}
  def open(dir, key) do
    with :ok <- Private.folder(Path.join(dir, "desired")),
         :ok <- Format.mark(dir, @format),
         {:ok, instance} <- kept(Path.join(dir, "instance")),
         {:ok, key} <- if(key, do: {:ok, key}, else: kept_key(dir)) do
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

  defp kept_key(dir) do
    with {:ok, text} <- kept(Path.join(dir, "key")), do: {:ok, Secret.new(text)}
  end

  defp kept(path) do
    case File.read(path) do
      {:ok, text} when byte_size(text) >= 16 ->
        {:ok, String.trim(text)}

      _none_or_damaged ->
        new = random()
        with :ok <- Private.write(path, new), do: {:ok, new}
    end
  end

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
