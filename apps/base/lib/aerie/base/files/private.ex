defmodule Aerie.Base.Files.Private do
  @moduledoc "Files and folders for their owner only (modes 0600 and 0700), whatever the umask is."

  alias Aerie.Base.Files.Raw

  @doc "Makes a folder, and those above it that are missing. An existing one is closed to others, if it is ours; those above it are not touched."
  @spec folder(Path.t()) :: :ok | {:error, File.posix()}
  def folder(dir) do
    made = [dir | missing(Path.dirname(dir))]
    with :ok <- Raw.mkdir_p(dir), do: Enum.each(made, &Raw.chmod(&1, 0o700))
  end

  defp missing(dir), do: if(Raw.dir?(dir), do: [], else: [dir | missing(Path.dirname(dir))])

  @doc "The same, but an existing folder stays as it is: somebody may have opened it to others on purpose."
  @spec new_folder(Path.t()) :: :ok | {:error, File.posix()}
  def new_folder(dir), do: if(Raw.dir?(dir), do: :ok, else: folder(dir))

  @doc """
  Writes a file. Readers find the old or the new text, never a part of it, and others can never read it. That holds
  after a power cut as well, unless `sync?` is false: for what is written often, and lost without harm.
  """
  @spec write(Path.t(), iodata(), sync? :: boolean()) :: :ok | {:error, File.posix()}
  def write(path, text, sync? \\ true) do
    new = path <> ".new"
    _ = Raw.rm(new)

    with {:ok, result} <- File.open(new, [:write, :exclusive, :raw], &fill(&1, new, text, sync?)),
         :ok <- result do
      Raw.rename(new, path)
    end
  end

  # The mode comes before the text.
  defp fill(file, path, text, sync?) do
    with :ok <- Raw.chmod(path, 0o600), :ok <- :file.write(file, text) do
      if sync?, do: :file.datasync(file), else: :ok
    end
  end
end
