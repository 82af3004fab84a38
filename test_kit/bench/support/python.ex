defmodule Bench.Python do
  @moduledoc "Peers in Python: `$AERIE_VENV`, or `.venv` at the top of the checkout."

  @venv Path.expand("../../../.venv", __DIR__)

  @doc "The Python that has a module, or nil."
  def find(module) do
    python = Path.join([System.get_env("AERIE_VENV") || @venv, "bin", "python"])

    if File.exists?(python) and
         match?({_, 0}, System.cmd(python, ["-c", "import #{module}"], stderr_to_stdout: true)),
       do: python
  end

  @doc "What a script of this folder prints."
  def run(python, script, args) do
    {output, 0} = System.cmd(python, [Path.join(__DIR__, script) | Enum.map(args, &to_string/1)])
    output
  end

  @doc "The same of a script that parses the bytes of a file so many times: its numbers, and the frames that it found."
  def parse(python, script, data, rounds) do
    Bench.Gateway.in_folder("parse", fn folder ->
      [stream, found] = for name <- ~w(stream found), do: Path.join(folder, name)
      File.write!(stream, data)

      numbers =
        for word <- String.split(run(python, script, [stream, rounds, found])), do: String.to_float(word)

      {numbers, with({:error, :enoent} <- File.read(found), do: {:ok, ""}) |> elem(1)}
    end)
  end
end
