defmodule Aerie.Base.Files.Disk do
  @moduledoc "A disk, as the operating system tells it: its free space, and when what was written is on it."

  @doc "Free bytes on the disk of a folder; `:unknown` if that cannot be found out. Runs a program, so call it seldom."
  @spec free(Path.t()) :: {:ok, non_neg_integer()} | :unknown
  def free(dir) do
    # POSIX output: one line for the file system. The device and the folder may have spaces; between them stand its size, what is used and
    # what is available in KiB, and a percentage.
    with program when is_binary(program) <- System.find_executable("df"),
         {text, 0} <- System.cmd(program, ["-Pk", dir], stderr_to_stdout: true, env: [{"LC_ALL", "C"}]),
         [_all, kilobytes] <- Regex.run(~r/ \d+ +\d+ +(\d+) +\d+% /, text) do
      {:ok, String.to_integer(kilobytes) * 1024}
    else
      _anything -> :unknown
    end
  end

  @doc """
  Returns when all that any process wrote to a file would survive a power cut. That can take seconds (an SD card), so a process that
  others wait for has it done by another one.
  """
  @spec sync(Path.t()) :: :ok | {:error, File.posix()}
  def sync(path) do
    # For reading: one that is gone must not be made.
    with {:ok, file} <- :file.open(path, [:read, :raw]) do
      result = :file.datasync(file)
      _ = :file.close(file)
      result
    end
  end
end
