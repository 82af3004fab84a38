# Copies what Mix has compiled, as it is needed to run it without Mix: `mix run --no-start --no-compile copy_code.exs FOLDER`
# makes FOLDER with lib/APP/{ebin,priv}, consolidated/ and sys.config. `bin/lib/code.sh` tells what for.
[folder] = System.argv()
build = Mix.Project.build_path()

# What Mix itself would load: not everything that once was compiled.
for ebin <- Enum.map(:code.get_path(), &List.to_string/1), String.starts_with?(ebin, build), Path.basename(ebin) == "ebin" do
  app = Path.dirname(ebin)
  target = Path.join([folder, "lib", Path.basename(app)])
  File.mkdir_p!(target)
  File.cp_r!(ebin, Path.join(target, "ebin"))
  # Often a link into the sources, which may change.
  priv = Path.join(app, "priv")
  if File.dir?(priv), do: File.cp_r!(priv, Path.join(target, "priv"), dereference_symlinks: true)
end

File.cp_r!(Path.join(build, "consolidated"), Path.join(folder, "consolidated"))

config = Config.Reader.read!("config/config.exs", env: Mix.env(), target: Mix.target())
File.write!(Path.join(folder, "sys.config"), :io_lib.format(~c"%% coding: utf-8~n~tp.~n", [config]))
