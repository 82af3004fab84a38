defmodule Aerie.Bench.Yamspy do
  @moduledoc "YAMSPy on the same bytes, when there is a Python that has it: `$AERIE_VENV`, or `.venv` at the top of the checkout."

  @script Path.expand("yamspy_parse.py", __DIR__)
  @venv Path.expand("../../../../.venv", __DIR__)

  @doc "The Python to use, or `nil`."
  def python do
    [System.get_env("AERIE_VENV"), @venv]
    |> Enum.reject(&(&1 in [nil, ""]))
    |> Enum.map(&Path.join([&1, "bin", "python"]))
    |> Enum.find(
      &(File.exists?(&1) and match?({_, 0}, System.cmd(&1, ["-c", "import yamspy"], stderr_to_stdout: true)))
    )
  end

  @doc "{best, median, 99th percentile} of ns per frame."
  def parse(python, data, rounds) do
    file = Path.join(System.tmp_dir!(), "aerie-bench-#{System.pid()}.bin")

    try do
      File.write!(file, data)
      {out, 0} = System.cmd(python, [@script, file, to_string(rounds)])
      out |> String.split() |> Enum.map(&String.to_float/1) |> List.to_tuple()
    after
      File.rm(file)
    end
  end
end
