defmodule Aerie.PrivateFile do
  @moduledoc "Files and folders that are for their owner alone (modes 0600 and 0700), whatever the umask is."

  @doc "Makes a folder, those above it too. One that is there already is closed to others where it is ours to do so."
  @spec folder(Path.t()) :: :ok | {:error, File.posix()}
  def folder(dir) do
    with :ok <- File.mkdir_p(dir) do
      _ = File.chmod(dir, 0o700)
      :ok
    end
  end

  @doc "The same, but one that is there stays as it is: somebody may have opened it to others on purpose."
  @spec new_folder(Path.t()) :: :ok | {:error, File.posix()}
  def new_folder(dir), do: if(File.dir?(dir), do: :ok, else: folder(dir))

  @doc "Writes a whole file. Whoever reads it finds the old or the new text, never part of it, and never an open mode."
  @spec write(Path.t(), iodata()) :: :ok | {:error, File.posix()}
  def write(path, text) do
    new = path <> ".new"
    _ = File.rm(new)

    with {:ok, result} <- File.open(new, [:write, :exclusive, :raw], &fill(&1, new, text)),
         :ok <- result do
      File.rename(new, path)
    end
  end

  # The mode comes before the text.
  defp fill(file, path, text), do: with(:ok <- File.chmod(path, 0o600), do: :file.write(file, text))
end
