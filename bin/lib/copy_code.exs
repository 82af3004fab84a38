# Copies compiled code so that it runs without Mix: `mix run --no-start --no-compile copy_code.exs FOLDER` fills FOLDER
# with lib/APP/{ebin,priv}, consolidated/ and sys.config. `bin/lib/code.sh` explains why.
[folder] = System.argv()
build = Mix.Project.build_path()

# Only what Mix itself would load; the build folder may have older apps.
for ebin <- Enum.map(:code.get_path(), &List.to_string/1), String.starts_with?(ebin, build), Path.basename(ebin) == "ebin" do
  app = Path.dirname(ebin)
  target = Path.join([folder, "lib", Path.basename(app)])
  File.mkdir_p!(target)
  File.cp_r!(ebin, Path.join(target, "ebin"))
  # priv is often a link into the sources, which may change.
  priv = Path.join(app, "priv")
  if File.dir?(priv), do: File.cp_r!(priv, Path.join(target, "priv"), dereference_symlinks: true)
end

consolidated = Path.join(folder, "consolidated")
File.cp_r!(Path.join(build, "consolidated"), consolidated)
# A checkout of a test has other apps.
loader = Aerie.CLI.Start.ModuleLoader
if Code.ensure_loaded?(loader), do: :ok = loader.pack(Path.join(folder, "lib/aerie/priv/code.zip"), consolidated)

# As users run it, whatever it was compiled for.
config = Config.Reader.read!("config/config.exs", env: :prod, target: Mix.target())
File.write!(Path.join(folder, "sys.config"), :io_lib.format(~c"%% coding: utf-8~n~tp.~n", [config]))
