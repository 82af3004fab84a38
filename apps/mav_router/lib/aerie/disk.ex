defmodule Aerie.Disk do
  @moduledoc "Free space, as the operating system tells it."

  @doc "Free bytes on the disk of a folder; `:unknown` if that cannot be found out. Runs a program, so call it seldom."
  @spec free(Path.t()) :: {:ok, non_neg_integer()} | :unknown
  def free(dir) do
    # POSIX output: one line for the file system, its fourth column is what is available, in KiB.
    with program when is_binary(program) <- System.find_executable("df"),
         {text, 0} <- System.cmd(program, ["-Pk", dir], stderr_to_stdout: true, env: [{"LC_ALL", "C"}]),
         [_head, line | _] <- String.split(text, "\n", trim: true),
         [_device, _size, _used, available | _] <- String.split(line),
         {kilobytes, ""} <- Integer.parse(available) do
      {:ok, kilobytes * 1024}
    else
      _anything -> :unknown
    end
  end
end
