defmodule MavRouter.Recorder.Files do
  @moduledoc """
  The recorder's access to files and disks, all in one place, so that a test can replace it by a disk that fails.
  """

  alias Aerie.Base.Files.Raw

  @type device :: :file.io_device()

  @doc "Makes a new file for its owner only."
  @callback create(Path.t()) :: :ok | {:error, term}
  @doc "Opens a file that `create/1` made, for the calling process."
  @callback open(Path.t()) :: {:ok, device} | {:error, term}
  @doc "Writes all bytes; after an error some of them may be written."
  @callback write(device, iodata) :: :ok | {:error, term}
  @doc "Forces all that was written to the disk."
  @callback sync(device) :: :ok | {:error, term}
  @callback close(device) :: :ok | {:error, term}
  @doc "Free bytes on the disk of a folder; `:unknown` if that cannot be found out."
  @callback free(Path.t()) :: {:ok, non_neg_integer} | :unknown

  @behaviour __MODULE__

  @impl __MODULE__
  def create(path) do
    with {:ok, file} <- :file.open(path, [:write, :exclusive, :raw]),
         :ok <- :file.close(file),
         do: Raw.chmod(path, 0o600)
  end

  @impl __MODULE__
  def open(path), do: :file.open(path, [:append, :raw, :binary])

  @impl __MODULE__
  def write(device, bytes), do: :file.write(device, bytes)

  @impl __MODULE__
  def sync(device), do: :file.datasync(device)

  @impl __MODULE__
  def close(device), do: :file.close(device)

  @impl __MODULE__
  def free(dir), do: Aerie.Base.Files.Disk.free(dir)
end
