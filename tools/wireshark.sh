#!/bin/sh
# Take a picture of Wireshark with the fields of a shot: wireshark.sh CAPTURE DISSECTOR PICTURE. Needs a display of
# 1500 by 900 pixels (xvfb-run), xdotool and ImageMagick.
set -e
XDG_CONFIG_HOME=$(mktemp -d)
export XDG_CONFIG_HOME
mkdir "$XDG_CONFIG_HOME/wireshark"
cat >"$XDG_CONFIG_HOME/wireshark/recent" <<'END'
gui.toolbar_main_show: FALSE
gui.filter_toolbar_show: FALSE
gui.geometry_main_maximized: TRUE
gui.geometry_main_upper_pane: 150
gui.geometry_main_lower_pane: 430
column.width: %m, 70, %t, 150, %p, 110, %i, 300
END
echo 'privs.warn_if_elevated: FALSE' >"$XDG_CONFIG_HOME/wireshark/recent_common"
echo 'gui.column.format: "No.", "%m", "Time", "%t", "Protocol", "%p", "Info", "%i"' >"$XDG_CONFIG_HOME/wireshark/preferences"
shown() { import -window root rgb:- | cksum; }
settle() { # until the screen has been the same for two seconds
	last=
	while now=$(shown) && [ "$now" != "$last" ]; do last=$now && sleep 2; done
}
wireshark -X "lua_script:$2" -d rtacser.data,lidar_emu -r "$1" -g 802 &
until xdotool search --onlyvisible --name "^$(basename "$1")\$" windowmove 0 0 windowsize 1500 900; do sleep 1; done
until import -window root png:- | convert - -crop 1x1+700+154 txt:- | grep -q 308CC6; do sleep 1; done # selected: blue
# All fields are unfolded, those of the frame and of the serial line folded, and the range of beam 0 is selected.
xdotool mousemove 300 700 click 1
for key in ctrl+Right Home Left Down Left Down; do settle && xdotool key $key; done
xdotool key --repeat 23 --delay 200 Down
settle
import -window root "$3"
kill $!
rm -r "$XDG_CONFIG_HOME"
